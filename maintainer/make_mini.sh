#!/usr/bin/env bash
# Make the light stage `mini` anew and put it into the package. Run after a change of its recipe or generator.
set -euo pipefail
cd "$(dirname "$0")/.."
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
.venv/bin/handbench data make openstage --size mini --folder "$work"
rm -rf handbench/data/openstage/mini
cp -r "$work"/openstage-mini-* handbench/data/openstage/mini
du -sh handbench/data/openstage/mini
