#!/usr/bin/env bash
# Make the smallest size of every open capture anew and put it into the package. Run after a change of their recipes or of
# the generator, and after maintainer/thumbnails.py, whose pictures they are compared with.
set -euo pipefail
cd "$(dirname "$0")/.."
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
for capture in openstage openscans openwild openphone; do
  .venv/bin/handbench data make "$capture" --size mini --folder "$work"
  place=handbench/data/openstage/mini
  [ "$capture" = openstage ] || place=$place-$capture
  rm -rf "$place"
  cp -r "$work/$capture"-mini-* "$place"
  du -sh "$place"
done
