"""Every public function of the Robotics API has a counterpart in Python, or a reason why not."""

from __future__ import annotations

import re

import pytest
from conftest import ROOT

import takt

API = ROOT / "rcc" / "api" / "src"
MODULES = """
activity arm base cell compose control cost coupled embedded explain expression fleet gripper handle io listener live
moving outcome plan pose prepared world
""".split()

OTHER_NAME = {
    "Arm.description": "Arm.joints",
    "Arm.finish_for": "Arm.finish",
    "Cell.connect": "connect",
    "Cell.connect_here": "connect",
    "Cell.connect_with": "connect",
    "Cell.embedded": "embed",
    "Cell.emulated": "emulate",
    "Fleet.cell": "Fleet.__getitem__",
    "Fleet.connect": "fleet",
    "Fleet.connect_with": "fleet",
    "Handle.poll_outcome": "Handle.__await__",
    "Handle.wait_for": "Handle.wait",
    "Handle.wait_to_end_for": "Handle.wait_to_end",
    "Pose.isometry": "Pose.matrix",
}
"""What has another name: options are keyword arguments, and constructors functions of the package."""

ABSENT = {
    "Cell.embedded_config": "its argument is a structure of Rust; `takt.embed` reads the same from a file",
    "Handle.place": "exceptions have the line, as `filename` and `lineno`",
    "Handle.wait_for_begin": "`begin` waits with it; a program that queues awaits the outcome",
}
"""What Python does not have, and why."""


def functions() -> set[str]:
    """The public functions and methods of the API, as `name` or `Type.name`."""
    found: set[str] = set()
    for module in MODULES:
        kind = ""
        for line in (API / f"{module}.rs").read_text().splitlines():
            if block := re.match(r"impl(?:<.*?>)? (\w+)(?:<\w+>)? \{", line):
                kind = block[1] + "."
            elif line == "}":
                kind = ""
            elif function := re.match(r"(    )?pub (?:const |async )?fn (\w+)", line):
                found.add((kind if function[1] else "") + function[2])
    return found


def variants(module: str, name: str) -> set[str]:
    """The variants of an enumeration of the API."""
    source = (API / f"{module}.rs").read_text()
    body = re.search(rf"pub enum {name} \{{\n(.*?)\n\}}", source, flags=re.DOTALL)
    assert body, name
    return set(re.findall(r"^    ([A-Z]\w+)", body[1], flags=re.MULTILINE))


def is_here(name: str) -> bool:
    """Whether the package has it."""
    kind, _, member = name.rpartition(".")
    return hasattr(getattr(takt, kind, None) if kind else takt, member)


def test_api_function_has_counterpart() -> None:
    found = functions()
    assert {"Arm.lin", "Cell.emulated", "together", "Plan.first"} <= found
    missing = {name for name in found - set(ABSENT) if not is_here(OTHER_NAME.get(name, name))}
    assert not missing, f"Python has no {sorted(missing)}\nhint: bind them, or give a reason in ABSENT"


def test_names_of_exceptions_are_current() -> None:
    stale = (set(OTHER_NAME) | set(ABSENT)) - functions()
    assert not stale, f"the API has no {sorted(stale)}"
    assert not [name for name in OTHER_NAME if is_here(name)]
    assert not [name for name in ABSENT if is_here(name)]


@pytest.mark.parametrize(("module", "name"), [("outcome", "Outcome"), ("compose", "Event")])
def test_variant_has_counterpart(module: str, name: str) -> None:
    missing = [variant for variant in variants(module, name) if not hasattr(getattr(takt, name), variant)]
    assert not missing


def test_error_variant_has_class() -> None:
    missing = [variant for variant in variants("error", "ErrorKind") if not hasattr(takt, variant)]
    assert not missing
