#!/usr/bin/env bash
# All tests, those against Python peers included: `bash tests/run.sh`. More words go to `cargo test`.
# With ZONAL_CORPUS set to the folder of measured data, the tests against it run too.
set -euo pipefail

fail() {
    echo "tests/run.sh: $1" >&2
    exit 1
}

features=peers,thorough
if [[ -n ${ZONAL_CORPUS:-} ]]; then
    [[ -d $ZONAL_CORPUS ]] || fail "ZONAL_CORPUS=$ZONAL_CORPUS is not a folder: correct it or unset it"
    # Absolute, since tests run in the root of the package.
    ZONAL_CORPUS=$(cd "$ZONAL_CORPUS" && pwd)
    export ZONAL_CORPUS
    features+=,corpus
else
    echo "tests/run.sh: ZONAL_CORPUS is not set: tests against measured data are left out" >&2
fi

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
cd "$root"

command -v cargo >/dev/null || fail "cargo is missing: install Rust 1.89 or newer"
if ! python3 -c 'import ensurepip, venv' 2>/dev/null && command -v apt-get >/dev/null; then
    echo "tests/run.sh: installing python3-venv" >&2
    as_root=()
    [[ $(id -u) == 0 ]] || as_root=(sudo -n)
    { "${as_root[@]}" apt-get update && "${as_root[@]}" apt-get install -y --no-install-recommends python3 python3-venv; } >&2 ||
        fail "python3 cannot make virtual environments: apt install python3 python3-venv"
fi
command -v python3 >/dev/null || fail "python3 is missing: install Python 3.11 or newer"

requirements=tests/python/requirements.txt
venv=target/venv
stamp=$venv/requirements.txt

# The stamp is written last, so a broken installation is done again.
if ! cmp -s "$requirements" "$stamp" || ! "$venv/bin/python" -c '' 2>/dev/null; then
    python3 -c 'import ensurepip, venv' 2>/dev/null ||
        fail "python3 cannot make virtual environments: apt install python3-venv"
    echo "tests/run.sh: installing Python peers into $venv" >&2
    rm -rf "$venv"
    python3 -m venv "$venv"
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check -r "$requirements"
    cp "$requirements" "$stamp"
fi
export ZONAL_PYTHON=$root/$venv/bin/python

cargo test --release --features "$features" "$@"
