"""Make sure that this environment has an LLVM that Dr.Jit can use. Standard library only; run by tools/bootstrap.sh.

In this order: one that is installed already; as root, the distribution's package; otherwise the distribution's package
downloaded and unpacked into the environment, where ``etendue.core.llvm`` looks first. ``--check`` only looks.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "src" / "etendue" / "core"))
import llvm  # type: ignore[import-not-found]

PACKAGES = ("libllvm19", "libllvm18", "libllvm17", "libllvm17t64", "libllvm20", "libllvm21")


def run(*command: str, cwd: Path | None = None) -> str:
    """Standard output of a command; raises ``CalledProcessError`` if it fails."""
    environment = os.environ | {"DEBIAN_FRONTEND": "noninteractive", "LC_ALL": "C"}
    return subprocess.run(command, cwd=cwd, check=True, capture_output=True, text=True, env=environment).stdout


def candidate(options: list[str]) -> str | None:
    """The first of PACKAGES that the package lists know in an installable version."""
    for package in PACKAGES:
        if re.search(r"Candidate: \d", run("apt-cache", *options, "policy", package)):
            return package
    return None


def install() -> None:
    """Install the package system-wide (root)."""
    if candidate([]) is None:
        run("apt-get", "update", "-qq")
    package = candidate([])
    if package is None:
        raise LookupError("this distribution has no LLVM package of version 17 to 21")
    print(f"installing {package} (as root, with apt-get)")
    try:
        run("apt-get", "install", "-y", "-qq", "--no-install-recommends", package)
    except subprocess.CalledProcessError:  # package lists that are out of date
        run("apt-get", "update", "-qq")
        run("apt-get", "install", "-y", "-qq", "--no-install-recommends", package)


def fetch(target: Path) -> None:
    """Download the package, and what it needs and the system lacks, and put the libraries into ``target``/lib."""
    with tempfile.TemporaryDirectory(prefix="etendue-llvm-") as scratch:
        work = Path(scratch)
        options: list[str] = []
        if (
            candidate(options) is None
        ):  # no package lists on this system, or old ones: fetch them into the scratch folder
            for folder in ("state/lists/partial", "cache/archives/partial"):
                (work / folder).mkdir(parents=True)
            options = ["-o", f"Dir::State={work}/state", "-o", f"Dir::Cache={work}/cache"]
            options += ["-o", "Dir::State::status=/var/lib/dpkg/status"]
            run("apt-get", *options, "update", "-qq")
        package = candidate(options)
        if package is None:
            raise LookupError("this distribution has no LLVM package of version 17 to 21")
        wanted = [p for p in dependencies(package, options) if p == package or not installed(p)]
        print(f"downloading {', '.join(wanted)} into {target} (no root needed)")
        debs = work / "debs"
        debs.mkdir()
        for name in wanted:
            run("apt-get", *options, "download", name, cwd=debs)
        for deb in sorted(debs.glob("*.deb")):
            run("dpkg-deb", "-x", str(deb), str(work / "root"))
        staged = target.with_name(target.name + ".new")
        shutil.rmtree(staged, ignore_errors=True)
        (staged / "lib").mkdir(parents=True)
        for file in (work / "root").rglob("*.so*"):
            # Files only: a library is known to the linker by the name inside it, links are not needed.
            if file.is_file() and not file.is_symlink() and re.search(r"\.so(\.[\d.]+)?$", file.name):
                shutil.copy2(file, staged / "lib" / file.name)
        shutil.rmtree(target, ignore_errors=True)
        staged.rename(target)


def dependencies(package: str, options: list[str]) -> list[str]:
    """``package`` and everything it depends on, directly or not."""
    listing = run("apt-cache", *options, "depends", "--recurse", "--important", package)
    return [package, *sorted({line for line in listing.splitlines() if re.match(r"[a-z0-9]", line)} - {package})]


def installed(package: str) -> bool:
    """Whether dpkg has the package."""
    query = ["dpkg-query", "-W", "-f", "${db:Status-Status}", package.partition(":")[0]]
    return "installed" in subprocess.run(query, capture_output=True, text=True).stdout.split("not-installed")


def reason(error: Exception) -> str:
    """The last line of what a command said, or the error itself."""
    lines = (getattr(error, "stderr", None) or str(error)).strip().splitlines()
    return lines[-1] if lines else type(error).__name__


def main() -> int:
    """Exit status 0 if a usable LLVM is there in the end."""
    if llvm.load_usable() is not None:
        return 0
    if "--check" in sys.argv[1:]:
        return 1
    trouble = "this system has no apt-get"
    if shutil.which("apt-get"):
        for attempt in [install] * (os.geteuid() == 0) + [lambda: fetch(llvm.private_directory())]:
            try:
                attempt()
                if (library := llvm.load_usable()) is not None:
                    print(f"LLVM {library.major}: {library.path}")
                    return 0
                trouble = "the library that was installed cannot be loaded"
            except (LookupError, OSError, subprocess.CalledProcessError) as error:
                trouble = reason(error)
    print(f"étendue needs LLVM {llvm.OLDEST} or newer, and it could not be fetched: {trouble}", file=sys.stderr)
    if sys.platform == "linux" and shutil.which("apt-get"):
        print("    sudo apt-get install -y libllvm19", file=sys.stderr)
    print("docs/install.md says what other systems need.", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
