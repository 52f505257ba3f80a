#!/usr/bin/env bash
# Everything that needs a GPU, in groups of at most three minutes: the table against gsplat, agreement, memory,
# start, visible sets, simulation, data, the device suite, compute-sanitizer. See docs/gpu_figures.md.
#
#   runs/gpu-figures.sh OUT                 all groups that are not done yet, in order
#   runs/gpu-figures.sh OUT small large     these groups, again if need be
#
# Environment:
#   PYTHON    interpreter (python3); gn0 itself is taken from this checkout
#   WHEELS    folder of wheels that the machine lacks; they are unpacked into OUT/site
#   SCENES    folder with apartment/ and small_house/ (gn0 scene generate, gn0 scene import)
#   GN0_DATA  third-party test data
#   GN0_GSPLAT_LIBRARY  a gsplat_cuda.so built before; else gsplat compiles its own (a minute)
#   LIMIT     seconds for each group, instead of its own limit
#   GN0_DEVICE=host     a dry run of everything on the emulation
set -uo pipefail

OUT=${1:?usage: runs/gpu-figures.sh OUT [group ...]}
shift
cd "$(dirname "$0")/.."
mkdir -p "$OUT/log" "$OUT/done"
OUT=$(cd "$OUT" && pwd)
PYTHON=${PYTHON:-python3}
ALL=(check start stages rival small large scenes apartment house accuracy memory visible sim data suite sanitizers sweep)
export GN0_CACHE=${GN0_CACHE:-$OUT/cache}
export TORCH_EXTENSIONS_DIR=${TORCH_EXTENSIONS_DIR:-$OUT/torch_extensions}
export PYTHONPATH=$PWD/src:$OUT/site${PYTHONPATH:+:$PYTHONPATH}
export MAX_JOBS=${MAX_JOBS:-$(nproc)}
if [ -n "${SCENES:-}" ]; then SCENES=$(cd "$SCENES" && pwd); export GN0_FIGURE_SCENES=$SCENES; fi

if [ -n "${WHEELS:-}" ] && [ ! -d "$OUT/site" ]; then
  mkdir -p "$OUT/site"
  for wheel in "$WHEELS"/*.whl; do "$PYTHON" -m zipfile -e "$wheel" "$OUT/site" || exit 1; done
fi

limit_of() {  # seconds
  if [ -n "${LIMIT:-}" ]; then echo "$LIMIT"; return; fi
  case $1 in
    check) echo 120 ;; small | accuracy | memory | data) echo 300 ;; sweep | suite) echo 420 ;; sanitizers) echo 540 ;; *) echo 240 ;;
  esac
}

figures() { "$PYTHON" -m gn0 figures "$@" --out "$OUT" ${SCENES:+--scenes "$SCENES"}; }

group() {
  case $1 in
    check)  # what is here, and whether all that is needed can be imported
      nvidia-smi --query-gpu=name,driver_version,memory.total --format=csv,noheader 2>/dev/null
      "$PYTHON" - <<'END'
import importlib.util as util
import sys
need = "numpy scipy numba msgspec tyro docstring_parser typeguard typing_extensions gymnasium cloudpickle farama_notifications pyarrow PIL yaml pytest pytest_timeout"
good = "torch gsplat jaxtyping ninja rich cupy"
print("missing:", [n for n in need.split() if not util.find_spec(n)] or "nothing")
import numba, numpy, pyarrow, scipy  # one that does not fit the others fails here
print("Python", sys.version.split()[0], *(f"{m.__name__} {m.__version__}" for m in (numpy, numba, scipy, pyarrow)))
print("missing, and not needed:", [n for n in good.split() if not util.find_spec(n)] or "nothing")
from gn0.render.renderer import choose_backend
print("renderer:", *choose_backend("auto"))
END
      ;;
    rival)  # gsplat's kernels, compiled or loaded; the library is kept for other machines
      "$PYTHON" - <<'END'
import time
from gn0.errors import Gn0Error
from gn0.figures.flat import build_flat, flat_camera, flat_views
start = time.perf_counter()
try:
    from gn0.figures.rival import open_rival, rival_version
    open_rival(build_flat(1000)).render(flat_camera(32, 32), flat_views(1))
    print(rival_version(), f"is ready after {time.perf_counter() - start:.1f} s")
except Gn0Error as error:
    print("no ratios to gsplat:", error)
END
      find "$TORCH_EXTENSIONS_DIR" -name gsplat_cuda.so -exec cp {} "$OUT" \; 2>/dev/null
      true
      ;;
    stages) "$PYTHON" -m gn0.figures.tune ;;         # milliseconds of each kernel
    sweep) "$PYTHON" -m gn0.figures.tune --sweep ;;  # other kernel sizes
    data) figures data --backend cuda ;;
    *) figures "render.cuda.$1" ;;
  esac
}

again=$#
[ $# -gt 0 ] || set -- "${ALL[@]}"
for name in "$@"; do
  case " ${ALL[*]} " in *" $name "*) ;; *) echo "no group $name; there are ${ALL[*]}"; exit 2 ;; esac
done
for name in "$@"; do
  if [ "$again" = 0 ] && [ -e "$OUT/done/$name" ]; then continue; fi
  printf '\n== %s (%d s)\n' "$name" "$SECONDS"
  begin=$SECONDS
  export -f group figures
  export OUT PYTHON SCENES
  timeout --signal=INT --kill-after=10 "$(limit_of "$name")" bash -c "group $name" 2>&1 | tee "$OUT/log/$name.txt"
  code=${PIPESTATUS[0]}
  # 1 is a missed target: measured all the same; a traceback is a figure that broke off
  if [ "$code" -le 1 ] && ! grep -q '^Traceback' "$OUT/log/$name.txt"; then echo "$code, $((SECONDS - begin)) s" > "$OUT/done/$name"
  else echo "== $name did not end well ($code) after $((SECONDS - begin)) s; its rows so far are kept"; fi
done

printf '\n== summary (%d s)\n' "$SECONDS"
for name in "${ALL[@]}"; do
  if [ -e "$OUT/done/$name" ]; then echo "$name: done ($(cat "$OUT/done/$name"))"; else echo "$name: not done"; fi
done
if [ -e "$OUT/figures.md" ]; then grep -E '^\| |^## |Unfinished|not measured' "$OUT/figures.md" | cut -c1-200; fi
