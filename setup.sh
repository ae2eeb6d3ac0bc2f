#!/bin/sh
# setup.sh VENV REQUIREMENTS [SYSTEM_PACKAGE ...]
# Create the virtual environment and install missing system packages on Debian and its derivatives (as root or with sudo;
# otherwise print the exact line), then the pinned Python packages.
set -eu
venv=$1 requirements=$2
shift 2

if command -v dpkg-query >/dev/null 2>&1; then
    missing=
    # For Python and the window.
    for p in python3-venv libgomp1 libgl1 libegl1 libx11-6 libxcursor1 libxi6 libxinerama1 libxrandr2 "$@"; do
        # A Python with its own venv module needs no package for it.
        [ "$p" = python3-venv ] && python3 -c 'import ensurepip, venv' 2>/dev/null && continue
        # A Python of the user's own has its own library.
        [ "$p" = libpython3-dev ] && [ "$(command -v python3)" != /usr/bin/python3 ] && continue
        dpkg-query -W -f '${Status}' "$p" 2>/dev/null | grep -q 'ok installed' || missing="$missing $p"
    done
    if [ -n "$missing" ]; then
        line="apt-get update && apt-get install -y --no-install-recommends$missing"
        if [ "$(id -u)" = 0 ]; then as=
        elif sudo -n true 2>/dev/null; then as=sudo
        else
            echo "System packages are missing. Install them, then run this again:" >&2
            echo "  sudo sh -c '$line'" >&2
            exit 1
        fi
        echo "installing system packages:$missing"
        DEBIAN_FRONTEND=noninteractive $as sh -c "($line) >/tmp/vrgs-apt.$$ 2>&1" || {
            tail -n 5 /tmp/vrgs-apt.$$ >&2
            echo "This failed: $line" >&2
            exit 1
        }
        $as rm -f /tmp/vrgs-apt.$$
    fi
fi

# All pins have wheels for Python 3.11 to 3.14 (tests/pins.py).
python=
for p in python3.11 python3.12 python3.13 python3.14 python3; do
    if "$p" -c 'import sys, venv, ensurepip; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 14))' 2>/dev/null; then
        python=$p
        break
    fi
done
[ -n "$python" ] || {
    echo "No Python 3.11 to 3.14 with venv was found. On Ubuntu 22.04: sudo apt-get install python3.11-venv" >&2
    exit 1
}

[ -x "$venv/bin/python" ] || "$python" -m venv "$venv"
echo "installing Python packages ($requirements; the first time takes a few minutes)"
"$venv/bin/python" -m pip install --quiet --disable-pip-version-check -r "$requirements"
