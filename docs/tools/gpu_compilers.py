"""Builds every program for GPUs that are not there, and records what each kernel costs on them.

    python docs/tools/gpu_compilers.py --setup FOLDER             fetches the compilers of Debian 12 and PyPI: 0.7 GB
    python docs/tools/gpu_compilers.py --setup FOLDER --newer     also those of Debian's development release: 1 GB more
    GFFE_GPU_COMPILERS=FOLDER python docs/tools/gpu_compilers.py  builds, in every form that a GPU gets; records into
                                                                  docs/measured/gpu_compilers.json; writes the table
    python docs/tools/gpu_compilers.py --tables                   only writes the table, from what is recorded

Nothing is installed. It needs x86-64 Linux with apt and pip. Exit code 1 if a program does not build.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import asdict
from datetime import date
from pathlib import Path

from pages import DOCS, MEASURED, recorded, table, with_all, write_record

PAGE, RECORD = DOCS / "portability.md", MEASURED / "gpu_compilers.json"
MIRROR, KEYRING = "http://deb.debian.org/debian", "/usr/share/keyrings/debian-archive-keyring.gpg"
RELEASE = ("clang-19", "lld-19", "libclc-19", "rocm-device-libs", "intel-opencl-icd")
DEVELOPMENT = ("clang-22", "lld-22", "rocm-device-libs-21", "intel-ocloc", "libigc2", "libigdfcl2")
PYTHON = ("nvidia-cuda-nvcc", "nvidia-cuda-nvdisasm")
GPUS = ("sm_86", "gfx1030", "gfx1100", "dg2-g10")


# ---- fetching ----------------------------------------------------------------------------------------------------


def set_up(folder: Path, newer: bool) -> None:
    """Fetch the compilers into `folder`."""
    folder = folder.resolve()
    pip = (
        sys.executable,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
        "--upgrade",
        "--no-deps",
        "--target",
    )
    subprocess.run([*pip, folder / "python", *PYTHON], check=True)
    unpack(folder / "release", "bookworm", RELEASE)
    if newer:
        unpack(folder / "sid", "sid", DEVELOPMENT)


def unpack(folder: Path, release: str, packages: Iterable[str]) -> None:
    """Unpack packages of a release of Debian, and all that they depend on, into a folder with an apt of its own."""
    apt = folder / "apt"
    for name in ("lists/partial", "cache/archives/partial"):
        (apt / name).mkdir(parents=True, exist_ok=True)
    (apt / "status").touch()
    (apt / "sources.list").write_text(f"deb [signed-by={KEYRING}] {mirror()} {release} main\n")
    settings = {
        "Dir::Etc::sourcelist": apt / "sources.list",
        "Dir::Etc::sourceparts": "-",
        "Dir::State::lists": apt / "lists",
        "Dir::State::status": apt / "status",
        "Dir::Cache": apt / "cache",
        "Debug::NoLocking": "1",
        "APT::Sandbox::User": "",
        "APT::Architecture": "amd64",
    }
    command = ["apt-get", "-qq", *(f"-o{name}={value}" for name, value in settings.items())]
    subprocess.run([*command, "update"], check=True)
    choice = ("--no-install-recommends", "--download-only", "-y", "install")
    subprocess.run([*command, *choice, *packages], check=True, stdout=subprocess.DEVNULL)
    archives = sorted((apt / "cache/archives").glob("*.deb"))
    for archive in archives:
        content = subprocess.run(["dpkg-deb", "--fsys-tarfile", archive], check=True, stdout=subprocess.PIPE).stdout
        subprocess.run(["tar", "-x", "-C", folder, "--keep-directory-symlink"], input=content, check=True)
    versions = sorted(" ".join(archive.name.replace("%3a", ":").split("_")[:2]) for archive in archives)
    (folder / "packages.txt").write_text("\n".join(versions) + "\n")
    shutil.rmtree(apt)


def mirror() -> str:
    """Return the mirror of Debian that this machine uses, if it does."""
    asked = subprocess.run(["apt-get", "indextargets", "--format", "$(REPO_URI)"], capture_output=True, text=True)
    return next((line.rstrip("/") for line in asked.stdout.splitlines() if line.endswith("/debian/")), MIRROR)


# ---- building ----------------------------------------------------------------------------------------------------


def record() -> list[str]:
    """Build everything and record it. Returns what does not build, a line each."""
    from vendor_compilers import COMPILERS, FILES, argument_bytes, build_all, compilers_folder

    from gffe_cl.engine.opencl.program import expand

    kernels: dict[str, dict] = {
        f"{name}.{kernel}": {"arguments": size}
        for name in FILES
        for kernel, size in argument_bytes(expand(f"{name}.cl")).items()
    }
    builds, failed = recorded("gpu_compilers")["builds"] if RECORD.exists() else {}, []
    for kind in COMPILERS:
        compiler = kind(compilers_folder())
        built = build_all(compiler)
        failures = [f"{one.program} ({one.form}) for {one.gpu}: {one.failure}" for one in built if one.failure]
        failed += failures
        builds[kind.vendor] = {
            "date": date.today().isoformat(),
            "compiler": compiler.version,
            "gpus": list(compiler.gpus),
            "programs": len(built),
            "built": len(built) - len(failures),
        }
        for one in reversed(built):  # of several forms, the first one stays
            for kernel, cost in one.costs.items():
                kernels[f"{one.program}.{kernel}"][one.gpu] = asdict(cost) | {"occupancy": round(cost.occupancy, 3)}
        print(f"{kind.vendor}: {len(built) - len(failures)} of {len(built)} build; {compiler.version}")
    if missing := set(GPUS).difference(*(costs for costs in kernels.values())):
        print(f"not recorded: these compilers do not know {', '.join(sorted(missing))} (--setup FOLDER --newer)")
        return failed
    write_record("gpu_compilers", {"builds": builds, "kernels": kernels})
    return failed


# ---- table -------------------------------------------------------------------------------------------------------


def builds_table() -> str:
    """Return the table of what builds with which compiler."""
    rows = [
        (vendor, ", ".join(one["gpus"]), one["compiler"], one["date"], f"{one['built']} of {one['programs']}")
        for vendor, one in recorded("gpu_compilers")["builds"].items()
    ]
    return table(("compiler of", "for", "versions", "on", "programs that build, in all forms"), rows)


TABLES = {"gpu_builds": builds_table}


def with_tables(text: str) -> str:
    """Return a page with the tables as the record has them."""
    return with_all(text, {name: make() for name, make in TABLES.items()})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--setup", type=Path, metavar="FOLDER")
    parser.add_argument("--newer", action="store_true")
    parser.add_argument("--tables", action="store_true")
    asked = parser.parse_args()
    if asked.setup:
        set_up(asked.setup, asked.newer)
        return
    failed = [] if asked.tables else record()
    PAGE.write_text(with_tables(PAGE.read_text("utf-8")), "utf-8")
    print(*(f"does not build: {line}" for line in failed), sep="\n", end="\n" if failed else "")
    sys.exit(bool(failed))


if __name__ == "__main__":
    main()
