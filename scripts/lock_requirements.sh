#!/usr/bin/env bash
# Pin what requirements*.in name: versions and hashes for Python 3.10 to 3.13, no addresses.
set -euo pipefail
cd "$(dirname "$0")/.."
common=(pip compile --quiet --upgrade --no-header --no-annotate --no-emit-index-url --generate-hashes)
for name in requirements requirements-ros requirements-train requirements-bench requirements-uv; do
  uv "${common[@]}" --universal --python-version 3.10 "$name.in" -o "$name.txt"
done

