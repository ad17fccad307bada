"""What Python adds to the time that a program in Rust needs, motion by motion in one run."""

from __future__ import annotations

import itertools
import statistics
import subprocess
import time

from conftest import BENT, program

import takt

ROUNDS = 150


def test_begin_takes_hardly_longer_than_in_rust(cell: takt.Cell, address: str) -> None:
    left, right = cell.arm("left"), cell.arm("right")
    assert takt.together(left.ptp(BENT), right.ptp(BENT)).run() == takt.Outcome.Completed
    command = [program("begin"), address, "right"]
    rust = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert rust.stdin is not None and rust.stdout is not None
    pairs: list[tuple[float, float]] = []
    for _, first in zip(range(ROUNDS), itertools.cycle([0.1, -0.1])):
        rust.stdin.write("\n")
        rust.stdin.flush()
        theirs = float(rust.stdout.readline()) / 1e3
        started = time.perf_counter()
        left.ptp([first, *BENT[1:]], speed=0.2, now=True).begin()
        pairs.append((theirs, (time.perf_counter() - started) * 1e3))
    rust.stdin.close()
    assert rust.wait(timeout=30.0) == 0
    in_rust, in_python = (statistics.median(side) for side in zip(*pairs))
    added = statistics.median(python - theirs for theirs, python in pairs)
    print(f"begin, p50 of {ROUNDS} pairs: Rust {in_rust:.2f} ms, Python {in_python:.2f} ms, added {added:.3f} ms")
    # A wait that is not woken takes a slice of 20 ms.
    assert in_python < 3 * in_rust
