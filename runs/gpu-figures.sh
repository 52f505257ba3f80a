#!/usr/bin/env bash
# Everything that needs a GPU, in groups of a few minutes, the most telling ones first: the table against gsplat,
# agreement, the device suite, memory, visible sets, simulation, data, compute-sanitizer. See benchmarks/gpu_figures.md.
#
#   runs/gpu-figures.sh OUT                 all groups that are not done yet, in order
#   runs/gpu-figures.sh OUT small large     these groups, again if need be
#
# Environment:
#   PYTHON    interpreter (python3); gn0 itself is taken from this checkout
#   WHEELS    folder of wheels that the machine lacks; they are unpacked into OUT/site
#   SCENES    folder with apartment/ and small_house/ (gn0 scene generate, gn0 scene import)
#   GN0_DATA  third-party test data
#   GN0_GSPLAT_LIBRARY  a gsplat_cuda.so built before, or that as .xz; where it does not load, and where there is
#             none, gsplat compiles its own (a minute)
#   LIMIT     seconds for each group, instead of its own limit
#   BUDGET    seconds for all: no group starts that has no time left, and none runs beyond it
#   KEEP      folder that gets board, logs (one archive) and a newly compiled library after every group
#   GN0_DEVICE=host     a dry run of everything on the emulation
set -uo pipefail

OUT=${1:?usage: runs/gpu-figures.sh OUT [group ...]}
shift
cd "$(dirname "$0")/.."
mkdir -p "$OUT/log" "$OUT/done"
OUT=$(cd "$OUT" && pwd)
if [ -n "${KEEP:-}" ]; then mkdir -p "$KEEP"; KEEP=$(cd "$KEEP" && pwd); fi
PYTHON=${PYTHON:-python3}
ALL=(check start rival small large scenes accuracy suite visible memory sim crowd moving parts people labels data apartment house others sanitizers stages sweep)
LIBRARY=$OUT/gsplat_cuda.so
export GN0_CACHE=${GN0_CACHE:-$OUT/cache}
export TORCH_EXTENSIONS_DIR=${TORCH_EXTENSIONS_DIR:-$OUT/torch_extensions}
. runs/offline.sh
export PYTHONUNBUFFERED=1 MAX_JOBS=${MAX_JOBS:-$(nproc)}
if [ -n "${SCENES:-}" ]; then SCENES=$(cd "$SCENES" && pwd); export GN0_FIGURE_SCENES=$SCENES; fi

open_offline "$OUT/site" || exit 1
if [ -n "${GN0_GSPLAT_LIBRARY:-}" ] && [ ! -e "$LIBRARY" ]; then
  case $GN0_GSPLAT_LIBRARY in
    *.xz) "$PYTHON" -c 'import lzma, shutil, sys; shutil.copyfileobj(lzma.open(sys.argv[1]), open(sys.argv[2], "wb"))' \
            "$GN0_GSPLAT_LIBRARY" "$LIBRARY" 2>/dev/null || rm -f "$LIBRARY" ;;
    *) cp "$GN0_GSPLAT_LIBRARY" "$LIBRARY" ;;
  esac
  [ -e "$LIBRARY" ] || echo "no library at $GN0_GSPLAT_LIBRARY"
fi

left() { echo $((${BUDGET:-1000000} - SECONDS - 5)); }  # seconds

limit_of() {  # seconds
  local limit left
  left=$(left)
  case $1 in
    check | start) limit=90 ;; stages) limit=120 ;; small | data | others) limit=300 ;; accuracy | suite | sweep) limit=400 ;;
    sanitizers) limit=540 ;; *) limit=240 ;;
  esac
  limit=${LIMIT:-$limit}
  echo $((limit < left ? limit : left))
}

least_of() {  # seconds without which a group is not begun
  case $1 in
    check | start | stages) echo 10 ;; suite | data | others) echo 60 ;; sanitizers) echo 120 ;; *) echo 30 ;;
  esac
}

figures() { "$PYTHON" -m gn0 figures "$@" --out "$OUT" ${SCENES:+--scenes "$SCENES"}; }

draw_rival() {  # a picture by gsplat; what it says when it cannot
  "$PYTHON" - <<'END'
import sys, time
from gn0.errors import Gn0Error
from gn0_figures.flat import build_flat, flat_camera, flat_views
start = time.perf_counter()
try:
    from gn0_figures.rival import open_rival, rival_version
    for degree in (0, 3):
        open_rival(build_flat(1000, sh_degree=degree)).render(flat_camera(32, 32), flat_views(1))
    print(rival_version(), f"is ready after {time.perf_counter() - start:.1f} s")
except Gn0Error as error:
    sys.exit(f"no ratios to gsplat: {error}")
END
}

group() {
  case $1 in
    check)  # what is here, and whether all that is needed can be imported
      nvidia-smi --query-gpu=name,driver_version,memory.total --format=csv,noheader 2>/dev/null
      "$PYTHON" -m gn0 doctor
      "$PYTHON" - <<'END'
import importlib.util as util
import sys
need = "numpy scipy numba msgspec tyro docstring_parser typeguard typing_extensions gymnasium cloudpickle farama_notifications pyarrow PIL yaml pytest pytest_timeout hypothesis"
good = "torch gsplat jaxtyping ninja rich cupy"
print("missing:", [n for n in need.split() if not util.find_spec(n)] or "nothing")
import numba, numpy, pyarrow, scipy  # one that does not fit the others fails here
print("Python", sys.version.split()[0], *(f"{m.__name__} {m.__version__}" for m in (numpy, numba, scipy, pyarrow)))
print("missing, and not needed:", [n for n in good.split() if not util.find_spec(n)] or "nothing")
from gn0_figures.catalogue import all_figures, left_out
print(len(all_figures()), "figures; left out:", left_out() or "none")
from gn0.render.open import choose_backend
print("renderer:", *choose_backend("auto"))
END
      ;;
    rival)  # gsplat's kernels, loaded or compiled
      if [ -e "$LIBRARY" ]; then
        if draw_rival; then return 0; fi
        echo "the library brought along does not serve; gsplat compiles its own"
        rm -f "$LIBRARY"
      fi
      unset GN0_GSPLAT_LIBRARY
      draw_rival
      find "$TORCH_EXTENSIONS_DIR" -name gsplat_cuda.so -exec cp {} "$LIBRARY" \; -exec touch "$OUT/compiled" \; 2>/dev/null
      true
      ;;
    stages) "$PYTHON" -m gn0_figures.tune ;;         # milliseconds of each kernel
    sweep) "$PYTHON" -m gn0_figures.tune --sweep "224x224 x" ;;  # other kernel sizes
    people) figures people.render.cuda --backend cuda ;;
    data) figures data.gpu --backend cuda ;;
    crowd) figures people.sim.cuda --backend cuda ;;
    others) figures data.gpu_others --backend cuda ;;
    sanitizers) GN0_FIGURE_SECONDS=$((LIMIT_NOW - 30)) figures render.cuda.sanitizers ;;  # rows of what was reached by then
    *) figures "render.cuda.$1" ;;
  esac
}

keep() {  # a few files, so that they are easily carried away
  if [ -z "${KEEP:-}" ]; then return; fi
  cp "$OUT"/figures.json "$OUT"/figures.md "$KEEP" 2>/dev/null
  tar -C "$OUT" -czf "$KEEP/log.tar.gz" log done
  if [ -e "$OUT/compiled" ] && [ ! -e "$KEEP/gsplat_cuda.so.xz" ]; then
    "$PYTHON" -c 'import lzma, sys; lzma.open(sys.argv[2], "wb", preset=1).write(open(sys.argv[1], "rb").read())' \
      "$LIBRARY" "$KEEP/gsplat_cuda.so.xz"
  fi
}

again=$#
[ $# -gt 0 ] || set -- "${ALL[@]}"
for name in "$@"; do
  case " ${ALL[*]} " in *" $name "*) ;; *) echo "no group $name; there are ${ALL[*]}"; exit 2 ;; esac
done
export -f group figures draw_rival
export OUT PYTHON SCENES LIBRARY
for name in "$@"; do
  if [ "$again" = 0 ] && [ -e "$OUT/done/$name" ]; then continue; fi
  if [ "$(left)" -lt "$(least_of "$name")" ]; then printf '\n== %s: no time left for it (%d s)\n' "$name" "$SECONDS"; continue; fi
  printf '\n== %s (%d s)\n' "$name" "$SECONDS"
  begin=$SECONDS
  if [ -e "$LIBRARY" ]; then export GN0_GSPLAT_LIBRARY=$LIBRARY; else unset GN0_GSPLAT_LIBRARY; fi
  # no pipe: a process that is left behind would hold it open, and us
  exec 9> >(exec tee "$OUT/log/$name.txt")
  says=$!
  limit=$(limit_of "$name")
  export LIMIT_NOW=$limit
  # first asked where it is (if there is time for that), then stopped, then killed
  timeout --signal=INT --kill-after=15 "$limit" \
    timeout --signal=USR1 --kill-after=13 "$((limit > 6 ? limit - 3 : limit + 60))" \
    bash -c "trap '' USR1; group $name" >&9 2>&1 9>&-
  code=$?
  exec 9>&-
  for _ in 1 2 3 4 5 6 7 8 9 10; do kill -0 "$says" 2>/dev/null || break; sleep 0.1; done
  kill "$says" 2>/dev/null  # something was left behind that could still speak
  # 1 is a missed target: measured all the same; a traceback is a figure that broke off
  if [ "$code" -le 1 ] && ! grep -q '^Traceback' "$OUT/log/$name.txt"; then echo "$code, $((SECONDS - begin)) s" > "$OUT/done/$name"
  else echo "== $name did not end well ($code) after $((SECONDS - begin)) s; its rows so far are kept"; fi
  keep
  if [ "$name" = start ] && [ ! -e "$OUT/done/start" ]; then echo "== without a first picture nothing else can come"; break; fi
done

printf '\n== summary (%d s)\n' "$SECONDS"
if [ -e "$OUT/figures.md" ]; then grep -E '^\| |^## |Unfinished|not measured' "$OUT/figures.md" | grep -v '^| ---' | cut -c1-120; fi
for name in "${ALL[@]}"; do
  if [ -e "$OUT/done/$name" ]; then echo "$name: done ($(cat "$OUT/done/$name"))"; else echo "$name: not done"; fi
done
