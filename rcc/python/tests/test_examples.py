"""Examples, the notebook, the tutorial and the README's programs run to their end on emulated robots."""

from __future__ import annotations

import json
import pathlib
import re
import subprocess
import sys
import threading
import time
from typing import Any

import pytest
from conftest import ROOT

ASSEMBLY = ROOT / "rcc" / "python" / "examples" / "assembly.py"
EXAMPLES = sorted(set(ASSEMBLY.parent.glob("*.py")) - {ASSEMBLY})
FIRST = ROOT / "rcc" / "python" / "examples" / "first.py"
READMES = [ROOT / "README.md", ROOT / "rcc" / "python" / "README.md"]
# As the tests in Rust have them: longer stalls lose frames, and several in a row a device.
TOLERATED_S = 0.001
ATTEMPTS = 5
DOCUMENTS = [ROOT / "docs" / "tutorial.md", ROOT / "rcc" / "python" / "README.md"]


def run(*arguments: str) -> str:
    """Runs an interpreter of its own, again while the host stalled meanwhile; returns what it printed."""
    command = [sys.executable, *arguments]
    attempt = 1
    while True:
        with Stalls() as stalls:
            result = subprocess.run(command, capture_output=True, text=True, timeout=120)
        if result.returncode == 0:
            return result.stdout
        is_final = stalls.longest_s <= TOLERATED_S or attempt == ATTEMPTS
        assert not is_final, result.stdout + result.stderr
        print(f"attempt {attempt}: the host stalled for {stalls.longest_s:.3f} s; trying again")
        attempt += 1


class Stalls:
    """Measures for how long the host kept a sleeping thread from running: drives lose their frames meanwhile."""

    longest_s = 0.0

    def __enter__(self) -> Stalls:
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over.set()
        self._thread.join()

    def _watch(self) -> None:
        before = time.monotonic()
        while not self._is_over.wait(0.001):
            now = time.monotonic()
            self.longest_s = max(self.longest_s, now - before - 0.001)
            before = now


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_ends_with_output(path: pathlib.Path) -> None:
    printed = run(str(path))
    print(printed)
    assert printed.strip()


def test_assembly_fetches_parts_and_inserts_peg() -> None:
    """The peg counts as inserted where contact is felt at most 3 mm before its seat; the rest of the program takes half a minute."""
    printed = run(str(ASSEMBLY), "--unloaded", "--last", "insert the peg")
    print(printed)
    steps = [re.split("  +", line)[0] for line in printed.splitlines() if not line.startswith("note: ")]
    assert steps == ["start and dock", "fetch the parts", "insert the peg"]


def test_first_program_of_readmes_lifts_box() -> None:
    program = FIRST.read_text().split('"""\n\n')[1]
    for document in READMES:
        assert f"```python\n{program}```" in document.read_text(), document
    *lines, lift = program.splitlines()
    assert len([line for line in lines if line]) == 7, "it has eight lines"
    height = "    print((left.pose().position + right.pose().position)[2] / 2)"
    before, outcome, after = run("-c", "\n".join([*lines, height, lift, height])).split()
    assert outcome == "Outcome.Completed" and abs(float(after) - float(before) - 0.1) < 1e-3


def test_notebook_runs_and_plots(tmp_path: pathlib.Path) -> None:
    notebook = ROOT / "rcc" / "python" / "examples" / "first.ipynb"
    ran = tmp_path / "first.ipynb"
    execute = pathlib.Path(sys.executable).with_name("jupyter-execute")
    run(str(execute), f"--output={ran}", str(notebook))
    cells: list[Any] = json.loads(ran.read_text())["cells"]
    outputs: list[Any] = [output for cell in cells for output in cell.get("outputs", [])]
    printed = "".join("".join(output.get("text", "")) for output in outputs)
    assert "Outcome.Completed True" in printed and "of the path" in printed, printed
    plots = [output for output in outputs if "image/png" in output.get("data", {})]
    assert len(plots) == 1
    source: list[Any] = json.loads(notebook.read_text())["cells"]
    assert not any(cell.get("outputs") for cell in source), "the notebook is kept without outputs"


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_document_programs_run(document: pathlib.Path) -> None:
    """The blocks of one document are one program."""
    blocks = re.findall(r"```python\n(.*?)```", document.read_text(), flags=re.DOTALL)
    assert blocks, f"{document} has no program"
    print(run("-c", "\n".join(blocks)))
