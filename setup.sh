#!/bin/sh
# Makes the environment from the lock: with uv where it is on the machine, else with venv and pip.
set -eu
python=$1
venv=$2

"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || {
    echo "set-up: wanted Python 3.11 or newer, got $("$python" --version 2>&1 || true); name one: make PYTHON=..." >&2
    exit 2
}

fail() {
    echo "set-up: the packages of requirements.lock could not be installed." >&2
    echo "        Is the package index reachable from here? The log is $venv/install.log" >&2
    tail -n 3 "$venv/install.log" >&2
    exit 2
}

no_venv() {
    echo "set-up: no virtual environment could be made in $venv with $python." >&2
    echo "        Is the folder writable, is its module venv installed (Debian: python3-venv)?" >&2
    exit 2
}

echo "set-up: installing the locked packages into $venv (once)"
if command -v uv >/dev/null 2>&1; then
    uv venv --quiet --allow-existing --python "$python" "$venv" || no_venv
    install() { uv pip install --quiet --python "$venv/bin/python" "$@" >>"$venv/install.log" 2>&1; }
else
    "$python" -m venv "$venv" || no_venv
    install() {
        "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-compile "$@" \
            >>"$venv/install.log" 2>&1
    }
fi
: >"$venv/install.log"
install --require-hashes -r requirements.lock || fail
# Compiled once by all cores, and without the packages' own tests: pip takes twice as long. What is
# installed meanwhile is compiled when it is imported.
"$venv/bin/python" -m compileall -q -j 0 -x '/tests/' "$venv/lib" >>"$venv/install.log" 2>&1 &
# One of the peers is a source package; it is built with what the lock has just installed.
install --require-hashes --no-deps --no-build-isolation -r peers.lock || fail
install --no-deps --no-build-isolation -e . || fail
# The harness is not in the wheel: a path file lets notebooks and workers import it.
"$venv/bin/python" -c "import pathlib, sysconfig; (pathlib.Path(sysconfig.get_path('purelib')) / 'bookkit.pth').write_text(str(pathlib.Path.cwd() / 'book'))" || fail
wait
touch "$venv/.installed"
