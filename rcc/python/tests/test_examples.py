"""Examples, the tutorial and the README's programs run to their end on emulated robots."""

from __future__ import annotations

import pathlib
import re
import subprocess
import sys

import pytest
from conftest import ROOT

EXAMPLES = sorted((ROOT / "rcc" / "python" / "examples").glob("*.py"))
DOCUMENTS = [ROOT / "docs" / "tutorial.md", ROOT / "rcc" / "python" / "README.md"]


def run(*arguments: str) -> str:
    """Runs an interpreter of its own; returns what it printed."""
    command = [sys.executable, *arguments]
    result = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_ends_with_output(path: pathlib.Path) -> None:
    printed = run(str(path))
    print(printed)
    assert printed.strip()


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_document_programs_run(document: pathlib.Path) -> None:
    """The blocks of one document are one program."""
    blocks = re.findall(r"```python\n(.*?)```", document.read_text(), flags=re.DOTALL)
    assert blocks, f"{document} has no program"
    print(run("-c", "\n".join(blocks)))
