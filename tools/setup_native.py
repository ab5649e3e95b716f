"""The libraries that Mitsuba and Dr.Jit need and their wheels lack: LLVM, libatomic. Run by tools/bootstrap.sh.

What is missing is, as root, installed from the distribution; otherwise the distribution's packages are downloaded and
unpacked into the environment, where ``etendue.core.llvm`` looks first. ``--missing`` only prints the packages' names.
Standard library only.
"""

from __future__ import annotations

import ctypes
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "src" / "etendue" / "core"))
import llvm  # type: ignore[import-not-found]

#: Packages with a usable LLVM, best first.
LLVM_PACKAGES = ("libllvm19", "libllvm18", "libllvm17", "libllvm17t64", "libllvm20", "libllvm21")
#: Other libraries by the packages that hold them.
OTHERS = {"libatomic.so.1": "libatomic1"}


def run(*command: str, cwd: Path | None = None) -> str:
    """Standard output of a command; raises ``CalledProcessError`` if it fails."""
    environment = os.environ | {"DEBIAN_FRONTEND": "noninteractive", "LC_ALL": "C"}
    return subprocess.run(command, cwd=cwd, check=True, capture_output=True, text=True, env=environment).stdout


def missing(llvm_package: str = LLVM_PACKAGES[0]) -> list[str]:
    """Names of the packages to install; empty if nothing is missing."""
    names = [] if llvm.load_usable() is not None else [llvm_package]
    for library, package in OTHERS.items():
        try:
            ctypes.CDLL(library)
        except OSError:
            names.append(package)
    return names


def available(options: list[str]) -> str | None:
    """The first of LLVM_PACKAGES that the package lists know in an installable version."""
    for package in LLVM_PACKAGES:
        if re.search(r"Candidate: \d", run("apt-cache", *options, "policy", package)):
            return package
    return None


def choose(options: list[str]) -> list[str]:
    """What to install, by the package lists; raises ``LookupError`` if an LLVM is wanted and they know none."""
    package = available(options)
    names = missing(package or "")
    if "" in names:
        raise LookupError("the package lists have no LLVM of version 17 to 21, or cannot be fetched")
    return names


def install() -> None:
    """Install system-wide (root)."""
    if available([]) is None:
        run("apt-get", "update", "-qq")
    packages = choose([])
    print(f"installing {', '.join(packages)} (as root, with apt-get)")
    command = ("apt-get", "install", "-y", "-qq", "--no-install-recommends", *packages)
    try:
        run(*command)
    except subprocess.CalledProcessError:  # package lists that are out of date
        run("apt-get", "update", "-qq")
        run(*command)


def fetch(target: Path) -> None:
    """Download the packages, and what they need and the system lacks, and copy their libraries to ``target``."""
    with tempfile.TemporaryDirectory(prefix="etendue-native-") as scratch:
        work = Path(scratch)
        options: list[str] = []
        if available(options) is None:  # no package lists on this system, or old ones: fetch them to one side
            for folder in ("state/lists/partial", "cache/archives/partial"):
                (work / folder).mkdir(parents=True)
            options = ["-o", f"Dir::State={work}/state", "-o", f"Dir::Cache={work}/cache"]
            options += ["-o", "Dir::State::status=/var/lib/dpkg/status"]
            run("apt-get", *options, "update", "-qq")
        packages = choose(options)
        wanted = [p for p in dependencies(packages, options) if p in packages or not installed(p)]
        print(f"downloading {', '.join(wanted)} into {target} (no root needed)")
        debs = work / "debs"
        debs.mkdir()
        run("apt-get", *options, "download", *wanted, cwd=debs)
        for deb in sorted(debs.glob("*.deb")):
            run("dpkg-deb", "-x", str(deb), str(work / "root"))
        target.mkdir(parents=True, exist_ok=True)
        for file in (work / "root").rglob("*.so*"):
            # Files only: a library is known to the linker by the name inside it, links are not needed.
            if file.is_file() and not file.is_symlink() and re.search(r"\.so(\.[\d.]+)?$", file.name):
                shutil.copy2(file, target / (file.name + ".new"))
                (target / (file.name + ".new")).rename(target / file.name)


def dependencies(packages: list[str], options: list[str]) -> list[str]:
    """``packages`` and everything they depend on, directly or not."""
    listing = run("apt-cache", *options, "depends", "--recurse", "--important", *packages)
    return sorted({line for line in listing.splitlines() if re.match(r"[a-z0-9]", line)})


def installed(package: str) -> bool:
    """Whether dpkg has the package."""
    query = ["dpkg-query", "-W", "-f", "${db:Status-Status}", package.partition(":")[0]]
    return "installed" in subprocess.run(query, capture_output=True, text=True).stdout.split("not-installed")


def reason(error: Exception) -> str:
    """The last line of what a command said, or the error itself."""
    lines = (getattr(error, "stderr", None) or str(error)).strip().splitlines()
    return lines[-1] if lines else type(error).__name__


def main() -> int:
    """Exit status 0 if nothing is missing in the end."""
    if "--missing" in sys.argv[1:]:
        print(*missing())
        return 0
    if sys.platform != "linux":
        OTHERS.clear()
    if not missing():
        return 0
    trouble = "this system has no apt-get"
    if shutil.which("apt-get"):
        attempts = [install] if os.geteuid() == 0 else []
        for attempt in [*attempts, lambda: fetch(llvm.private_directory())]:
            try:
                attempt()
                if not missing():
                    return 0
                trouble = "what was installed cannot be loaded"
            except (LookupError, OSError, subprocess.CalledProcessError) as error:
                trouble = reason(error)
    print(f"étendue needs {' and '.join(missing())}, and could not get it: {trouble}", file=sys.stderr)
    if shutil.which("apt-get"):
        print("    sudo apt-get install -y", *missing(), file=sys.stderr)
    print("docs/install.md says what other systems need.", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
