#!/bin/sh
# Make the environment: .venv with the pinned packages and étendue itself, and an LLVM that Dr.Jit can use.
#   tools/bootstrap.sh run    what the demo needs
#   tools/bootstrap.sh dev    what the tests need as well
# As root it installs what the system lacks; otherwise it prints one apt line for Python and venv, and unpacks the
# distribution's packages of LLVM into .venv (tools/setup_native.py). The Makefile runs this when a lock file changes.
set -eu
cd "$(dirname "$0")/.."
what=${1:-run}
venv=.venv

say() { printf '%s\n' "$*"; }
is_root() { [ "$(id -u)" = 0 ]; }
has_apt() { command -v apt-get >/dev/null 2>&1; }
recent() { "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1; }
has_venv() { "$1" -c 'import ensurepip, venv' >/dev/null 2>&1; }

find_python() {
    for candidate in ${PYTHON:-} python3 python3.14 python3.13 python3.12 python3.11; do
        if command -v "$candidate" >/dev/null 2>&1 && recent "$candidate"; then
            say "$candidate"
            return
        fi
    done
}

apt_install() {
    say "installing $* (as root, with apt-get)"
    export DEBIAN_FRONTEND=noninteractive
    apt-get install -y -qq --no-install-recommends "$@" >/dev/null 2>&1 ||
        { apt-get update -qq && apt-get install -y -qq --no-install-recommends "$@" >/dev/null; }
}

# The packages that are missing and without which nothing can start.
missing_packages() {
    python=$(find_python)
    if [ -z "$python" ]; then
        # Distributions whose python3 is too old often have a newer one beside it; else this name is the one to look for.
        if command -v python3 >/dev/null 2>&1; then say "python3.11 python3.11-venv"; else say "python3 python3-venv"; fi
    elif ! has_venv "$python"; then
        case $python in
            */*) say "python3-venv" ;;
            *) say "$python-venv" ;;
        esac
    fi
}

if [ ! -x "$venv/bin/python" ] || ! "$venv/bin/python" -c 'import pip' >/dev/null 2>&1; then
    missing=$(missing_packages)
    if [ -n "$missing" ] && has_apt && is_root; then
        # shellcheck disable=SC2086  # a list of package names
        apt_install $missing
        missing=$(missing_packages)
    fi
    if [ -n "$missing" ]; then
        if has_apt; then
            python=$(find_python)
            native="libllvm19 libatomic1"
            if [ -n "$python" ]; then native=$("$python" -B tools/setup_native.py --missing); fi
            say "étendue needs Python 3.11 or newer with venv. Run, then make again:" >&2
            say "    sudo apt-get install -y $missing $native" >&2
        else
            say "étendue needs Python 3.11 or newer with the venv module; docs/install.md says where to get it." >&2
        fi
        exit 1
    fi
    say "creating $venv with $("$(find_python)" --version)"
    "$(find_python)" -m venv --clear "$venv"
fi

pip() { "$venv/bin/python" -m pip --disable-pip-version-check --quiet "$@"; }

say "installing pinned packages into $venv"
if [ "$what" = dev ]; then
    pip install --only-binary :all: -r requirements.lock -r requirements-dev.lock
else
    pip install --only-binary :all: -r requirements.lock
fi
pip install --no-deps --no-build-isolation --editable .

"$venv/bin/python" -B tools/setup_native.py
