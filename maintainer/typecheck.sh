#!/usr/bin/env bash
# Type-check the package in the layout it installs in; mypy does not see the folders that an editable install maps.
#   usage: maintainer/typecheck.sh MYPY
set -euo pipefail
mypy=$(realpath --no-symlinks "$1")
cd "$(dirname "$0")/.."
top=$PWD
tree=build/typecheck
rm -rf "$tree"
mkdir -p "$tree"
cp -rs "$top/handbench" "$tree/"
for folder in methods metrics protocols reports; do cp -rs "$top/$folder" "$tree/handbench/"; done
cd "$tree"
"$mypy" --config-file "$top/pyproject.toml" --cache-dir "$top/.mypy_cache"
