#!/usr/bin/env bash
# Make .venv with everything handbench needs. Run by make; does nothing when nothing changed.
#   setup.sh         to use handbench and work on it
#   setup.sh test    what only tests need as well: a browser, LaTeX, Ray, outside references
#   setup.sh docs    what the documentation is built with as well
#   PYTHON           the interpreter to use, 3.11 or newer (default: python3)
set -euo pipefail
cd "$(dirname "$0")/.."
python=${PYTHON:-python3}
wanted=${1:-dev}
stamp=.venv/handbench-setup

say() { printf 'setup: %s\n' "$*" >&2; }

# The system packages that are missing: libusb for open3d, LLVM for Mitsuba's fast variant, a browser for tests of
# pages, LaTeX and a reader of its PDFs for tests of tables, venv for this script.
missing_packages() {
    local libraries
    libraries=$(PATH="$PATH:/sbin:/usr/sbin" ldconfig -p 2>/dev/null || true)
    grep -q 'libusb-1\.0\.so' <<<"$libraries" || echo libusb-1.0-0
    grep -q 'libLLVM[.-]*\(so\.\)*19' <<<"$libraries" || echo libllvm19
    if [ "$wanted" = test ]; then
        command -v chromium >/dev/null || echo chromium
        command -v pdflatex >/dev/null || echo texlive-latex-recommended
        command -v lualatex >/dev/null || echo texlive-luatex
        command -v pdftotext >/dev/null || echo poppler-utils
    fi
    [ -x .venv/bin/python ] || "$python" -c 'import ensurepip, venv' 2>/dev/null || echo python3-venv
}

install_packages() {
    local packages=("$@") root=()
    if ! command -v apt-get >/dev/null; then
        say "no apt here; if open3d or Mitsuba complain, install your system's libusb 1.0 and LLVM 19"
        return
    fi
    if [ "$(id -u)" -ne 0 ]; then
        if ! sudo -n true 2>/dev/null; then
            say "please run:  sudo apt-get install -y ${packages[*]}"
            return
        fi
        root=(sudo -n)
    fi
    say "installing system packages: ${packages[*]}"
    local apt=("${root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get -qq)
    "${apt[@]}" install -y "${packages[@]}" >/dev/null 2>&1 && return
    # The lists may be old or absent; then one by one, so that one that is unknown here does not stop the others.
    "${apt[@]}" update >/dev/null 2>&1 || true
    for package in "${packages[@]}"; do
        "${apt[@]}" install -y "$package" >/dev/null || say "could not install $package; handbench goes on without it"
    done
}

"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || {
    say "Python 3.11 or newer is needed, but '$python' is not; set PYTHON=/path/to/python3.11"
    exit 1
}
mapfile -t missing < <(missing_packages)
if [ ${#missing[@]} -gt 0 ]; then install_packages "${missing[@]}"; fi

# What an installation depends on; the folder too, since an editable install and a venv name it.
state=$({ pwd; cat pyproject.toml constraints.txt maintainer/setup.sh; } | cksum)
if [ -f "$stamp-$wanted" ] && [ "$(cat "$stamp-$wanted")" = "$state" ]; then exit 0; fi

if [ ! -x .venv/bin/python ]; then
    say "creating .venv"
    "$python" -m venv .venv || {
        rm -rf .venv
        say "could not create .venv; on Debian run:  sudo apt-get install -y python3-venv"
        exit 1
    }
fi
say "installing Python packages (several minutes the first time)"
rm -f "$stamp"-*
pip=(.venv/bin/python -m pip install -qq --disable-pip-version-check --constraint constraints.txt)
# torch first and by its exact version: a looser request may fetch gigabytes of GPU libraries.
"${pip[@]}" "$(grep '^torch==' constraints.txt)"
"${pip[@]}" "$(grep '^setuptools==' constraints.txt)"
extras=dev
[ "$wanted" != test ] || extras=dev,test,docs
[ "$wanted" != docs ] || extras=dev,docs
"${pip[@]}" --no-build-isolation --editable ".[$extras]"
for installed in ${extras//,/ }; do printf '%s\n' "$state" >"$stamp-$installed"; done
say "done"
