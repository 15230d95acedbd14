"""Fuzzes what reads files and numbers from outside: sequences, EXR headers, foreign captures, cameras and
options.

    python docs/tools/fuzz.py --minutes 10
    python docs/tools/fuzz.py --minutes 2 --target sequence:frame_1.exr --seed 7
    python docs/tools/fuzz.py --minutes 30 --arguments        # of every command, tests/helpers/fuzz_arguments.py

Each target of tests/helpers/fuzz_targets.py runs in a child process. With atheris (`pip install atheris`) mutations
follow the code that they reach; without, they are made by chance. An input that ends neither well nor with an error of
one line is kept in tests/captures/formats/fuzz_cases, which test_fuzz.py beside it reads again. Exit code 1 if there is
one.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from pages import REPOSITORY

TESTS = REPOSITORY / "tests"
CASES, WORK = TESTS / "captures/formats/fuzz_cases", TESTS / ".fuzz_corpus"
SECONDS, MEGABYTES = 20, 4096  # that one input may take


def plain(name: str) -> str:
    """Return a target's name as part of a file's name."""
    return name.replace(":", "@")


def pending(name: str) -> Path:
    """Return the file of a child's present input, which stays when a crash of a library ends the child."""
    WORK.mkdir(exist_ok=True)
    return WORK / f"{plain(name)}.pending"


def keep(name: str) -> Path:
    """Make a case of the input that a child died of, and return its file."""
    CASES.mkdir(exist_ok=True)
    data = pending(name).read_bytes()
    path = CASES / f"{plain(name)}-{hashlib.sha256(data).hexdigest()[:12]}"
    path.write_bytes(data)
    return path


def run_target(name: str, seconds: float, seed: int) -> None:
    """Try inputs in a child process until the time is over, or an input is a fault."""
    if importlib.util.find_spec("atheris"):
        run_with_atheris(name, seconds, seed)
    sys.path.insert(0, str(TESTS / "helpers"))
    import fuzz_targets

    target, rng = fuzz_targets.targets()[name], np.random.default_rng(seed)
    end, count, data = time.monotonic() + seconds, 0, target.seed
    while time.monotonic() < end:
        data = fuzz_targets.mutated(target, target.seed if rng.integers(4) else data, rng)[
            : 4 * len(target.seed) + 1024
        ]
        pending(name).write_bytes(data)
        fuzz_targets.check(target, data)
        count += 1
    print(f"{name}: {count} inputs")


def run_with_atheris(name: str, seconds: float, seed: int) -> None:
    """Does not return."""
    import atheris

    with atheris.instrument_imports(include=["gffe_cl"]):
        sys.path.insert(0, str(TESTS / "helpers"))
        import fuzz_targets
    target, rng = fuzz_targets.targets()[name], np.random.default_rng(seed)

    def one(data: bytes) -> None:
        pending(name).write_bytes(data)
        fuzz_targets.check(target, data)

    def mutate(data: bytes, most: int, _seed: int) -> bytes:
        if rng.integers(3) == 0:
            return atheris.Mutate(data, most)
        return fuzz_targets.mutated(target, data if rng.integers(4) else target.seed, rng)[:most]

    corpus = WORK / plain(name)
    corpus.mkdir(parents=True, exist_ok=True)
    (corpus / "seed").write_bytes(target.seed)
    limits = [f"-max_total_time={max(int(seconds), 1)}", f"-timeout={SECONDS}", f"-rss_limit_mb={MEGABYTES}"]
    limits += [f"-seed={seed + 1}", f"-max_len={4 * len(target.seed) + 1024}", f"-artifact_prefix={corpus}-"]
    limits += ["-verbosity=0", "-print_final_stats=1"]
    atheris.Setup([sys.argv[0], *limits, str(corpus)], one, custom_mutator=mutate)
    atheris.Fuzz()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--target", help="one target; all, if left out")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--arguments", action="store_true", help="command lines instead of files")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.child:
        run_target(chosen.target, chosen.minutes * 60, chosen.seed)
        return 0
    sys.path.insert(0, str(TESTS / "helpers"))
    if chosen.arguments:
        import fuzz_arguments

        with tempfile.TemporaryDirectory() as folder:
            return int(bool(fuzz_arguments.run(chosen.minutes * 60, chosen.seed, Path(folder))))
    import fuzz_targets

    names = [chosen.target] if chosen.target else list(fuzz_targets.targets())
    found, minutes = [], chosen.minutes / len(names)
    for number, name in enumerate(names):
        words = ["--child", "--target", name, "--minutes", str(minutes), "--seed", str(chosen.seed + number)]
        child = subprocess.run([sys.executable, __file__, *words], capture_output=True, text=True, errors="replace")
        told = re.search(r": (\d+) inputs$|number_of_executed_units: (\d+)", child.stdout + child.stderr, re.M)
        count = (told[1] or told[2]) if told else "an unknown number of"
        print(f"{name}: {count} inputs, {'a fault' if child.returncode else 'no fault'}", flush=True)
        if child.returncode:
            found.append(keep(name))
            print("\n".join([*child.stdout.splitlines()[-15:], *child.stderr.splitlines()[-8:]]))
    print("\n".join([f"{len(found)} faults", *(str(path) for path in found)]))
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
