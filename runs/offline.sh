# For a machine without a network, sourced by the scripts beside it: what PYTHON lacks comes from a folder of wheels.
#
#   open_offline SITE     unpacks $WHEELS into SITE, and names this checkout's gn0 there if it is not installed
#
# gn0 itself is taken from this checkout; SITE stands behind it on PYTHONPATH.

open_offline() {
  local site=$1 root wheel version
  root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
  export PYTHONPATH=$root/src:$root/benchmarks:$root/tests/trials:$site${PYTHONPATH:+:$PYTHONPATH}
  if [ -n "${WHEELS:-}" ] && [ ! -d "$site" ]; then
    rm -rf "$site.part" && mkdir -p "$site.part"
    for wheel in "$WHEELS"/*.whl; do "$PYTHON" -m zipfile -e "$wheel" "$site.part" || return 1; done
    mv "$site.part" "$site"
  fi
  if ! "$PYTHON" -c 'from importlib import metadata; metadata.version("gn0")' 2>/dev/null; then  # runs write it down
    version=$("$PYTHON" -c 'import gn0; print(gn0.__version__)') || return 1
    mkdir -p "$site/gn0-$version.dist-info"
    printf 'Metadata-Version: 2.1\nName: gn0\nVersion: %s\n' "$version" > "$site/gn0-$version.dist-info/METADATA"
  fi
}
