#!/usr/bin/env bash
# The ablation as a chain of jobs, each resumable: homes in lots, made beside the learner, and the trunk of one input and
# seed (SFT on the expert's walks). Give the same command again after any interruption: what is done is not done again.
#
#   runs/ablation.sh OUT                  all jobs: 400 homes to train in, 100 never seen, a card
#   runs/ablation.sh OUT tiny             the same in miniature, on a CPU, some minutes
#   runs/ablation.sh OUT full homes       this job alone
#
# Environment:
#   PYTHON    interpreter (python3)
#   WORKERS   homes made at a time (all cores but one)
#   INPUT     what the policy is shown: maps (near and far ego map), views (view and mosaic), or all
#   SEED      of weights, states and order (0)
#   SAMPLES   of the trunk (8000000), MINUTES of it at most (none)
#   JOINS     samples at which lots a, b and c join (0,500000,3000000)
#   EXAMINE   steps from examination to examination (0: at the end alone)
#   SOURCE    walks or uniform (walks)
#   PATHS     walks a home (40), each told in three ways
set -euo pipefail

OUT=${1:?usage: runs/ablation.sh OUT [tiny|full] [homes|trunk ...]}
SIZE=${2:-full}
shift $(($# < 2 ? $# : 2))
JOBS=${*:-homes trunk}
PYTHON=${PYTHON:-python3}
INPUT=${INPUT:-maps}
SEED=${SEED:-0}
SOURCE=${SOURCE:-walks}
WORKERS=${WORKERS:-$(($(nproc) > 1 ? $(nproc) - 1 : 1))}
HERE=$(cd "$(dirname "$0")" && pwd)
mkdir -p "$OUT"/{specs,homes,suites,log}

gn0() { "$PYTHON" -m gn0 "$@"; }
say() { printf '%s %s\n' "$(date -u +%H:%M:%S)" "$1" | tee -a "$OUT/log/chain"; }

# lots of homes: name, split, small flats, medium flats, houses; the spec's seed decides what no training home has
if [ "$SIZE" = tiny ]; then
  LOTS=("a train 2 0 0" "b train 1 0 0" "exam val_unseen 1 0 0")
else
  LOTS=("a train 30 14 4" "b train 60 30 10" "exam val_unseen 60 30 10" "c train 150 76 26")
fi

lot() { # NAME SPLIT FLATS HOMES HOUSES
  local spec=$OUT/specs/$1.yaml
  [ -f "$OUT/suites/$1/manifest.json" ] && return 0
  {
    printf 'name: lot-%s\nseed: 21\nval_seen: 1.0\nheld_out: {styles: [classic, dark modern], variants: 0.25}\nparts:\n' "$1"
    part() { [ "$2" = 0 ] || printf '  - {%s, count: %s, density: 2500, light: draft, split: %s, name: %s}\n' "$3" "$2" "$SPLIT" "$1"; }
    SPLIT=$2
    part "$1-flat" "$3" "kind: apartment, size: small"
    part "$1-home" "$4" "kind: apartment, size: medium"
    part "$1-house" "$5" "kind: residence, size: small"
  } > "$spec"
  say "lot $1: homes"
  NUMBA_NUM_THREADS=1 gn0 scene corpus --spec "$spec" --out "$OUT/homes/$1" --workers "$WORKERS" --no-sheet > "$OUT/log/homes-$1" 2>&1
  say "lot $1: missions"
  NUMBA_NUM_THREADS=1 gn0 missions generate "$OUT/homes/$1" --spec "$HERE/ablation/missions.yaml" --camera tiny_128 --seed 21 \
    --per-scene "${PATHS:-40}" --workers "$WORKERS" --out "$OUT/suites/$1" > "$OUT/log/missions-$1" 2>&1
  say "lot $1: done"
}

homes() {
  for one in "${LOTS[@]}"; do
    # shellcheck disable=SC2086
    lot $one
  done
}

trunk() {
  local pictures run=$OUT/trunk-$INPUT-$SOURCE-$SEED
  case $INPUT in
    maps) pictures=near,far points=13 ;;
    views) pictures=rgb,history points=0 ;;
    all) pictures=rgb,history,near,far points=13 ;;
    *) echo "INPUT is maps, views or all" >&2; return 2 ;;
  esac
  local more=(--samples "${SAMPLES:-8000000}" --minutes "${MINUTES:-0}" --examine "${EXAMINE:-0}" --save 500 --shard-mb 15)
  local suites=("$OUT/suites/a" "$OUT/suites/b" "$OUT/suites/c") joins=${JOINS:-0,500000,3000000}
  if [ "$SIZE" = tiny ]; then
    suites=("$OUT/suites/a" "$OUT/suites/b") joins=0,64
    more=(--samples "${SAMPLES:-160}" --size nano --batch 16 --agents 16 --kept 320 --report 2 --save 4 --examined 2 --asked 64 --device host)
  fi
  until [ -f "${suites[0]}/manifest.json" ]; do sleep 1; done
  say "trunk: $INPUT, $SOURCE, seed $SEED"
  gn0 train sft "${suites[@]}" --joins "$joins" --exam "$OUT/suites/exam" --text-length 120 --source "$SOURCE" \
    --pictures "$pictures" --points "$points" --seed "$SEED" --out "$run" "${more[@]}" 2>&1 | tee -a "$OUT/log/trunk-$INPUT-$SOURCE-$SEED"
  say "trunk: done"
}

in_turn() {
  for job in $JOBS; do
    case $job in
      homes) ;;
      trunk) trunk ;;
      *) echo "jobs are homes and trunk, not $job" >&2; return 2 ;;
    esac
  done
}

set -m  # either in a process group of its own: if one fails, the other has nothing to wait for
trap 'for group in $(jobs -pr); do kill -- "-$group" 2>/dev/null || true; done' EXIT
running=1
case " $JOBS " in *" homes "*) homes & running=2 ;; esac
in_turn &
for ((; running > 0; running--)); do
  wait -n || { status=$?; say "failed; see $OUT/log"; exit $status; }
done
say "all done"
