#!/usr/bin/env bash
# A leg of the policy in the box on a machine that is lent for half an hour, with nothing to decide in between: homes are
# made beside a figure, which leaves the card to itself anyway; the leg is trained on the first card, other figures have
# the second one meanwhile, where there is one; and what travels home is packed.
#
#   runs/leg.sh OUT                             the first leg, from random weights
#   LEG=2 FROM=release/bae-tiny runs/leg.sh OUT the second, from the weights of the first
#   WALL=9 runs/ablation.sh OUT full watch      how it is going, from another terminal; OUT/leg.log has the rest
#   SIZE=tiny GN0_DEVICE=host runs/leg.sh OUT   a rehearsal on a CPU
#
# Environment: that of runs/ablation.sh, and
#   SIZE      full, or tiny
#   MINUTES   of the leg at most (18); UNTIL: seconds since 1970 by which its training ends, whatever came before took
#   FIGURE    that has the cards while homes are made (train.speed, which finds the speed of the leg where SPEED is not given;
#             empty: none)
#   SECONDS_OF_FIGURE  that it may take at most (290)
#   HOMES     lots that are made before it is trained (the first of LEG_LOTS, homes-a, and homes-exam but for EXAMINED=0);
#             all others of LEG_LOTS join later
#   EXAMS_UNTIL  seconds since 1970 until when the policy is examined after it was packed, with the walks of 'shipped-*'
#             (empty: not); three examinations share a card. Walks that ended are packed, too
#   JOIN_LATE  empty: the leg waits for lots that are late; else it learns on meanwhile
#   BESIDE    figures that the second card is given, one after another, while the first one trains (none)
# A card that is no good for driven walks leaves a failed job: OUT/jobs/shipped-LEG.failed says why.
set -uo pipefail

OUT=${1:?usage: runs/leg.sh OUT}
cd "$(dirname "$0")/.."
mkdir -p "$OUT/figures"
OUT=$(cd "$OUT" && pwd)
export PYTHON=${PYTHON:-python3} SIZE=${SIZE:-full} LEG=${LEG:-1} MINUTES=${MINUTES:-18} PYTHONUNBUFFERED=1
export WORKERS=${WORKERS:-$(($(nproc) > 3 ? $(nproc) - 3 : 1))}
export JOIN_LATE=${JOIN_LATE-1} LEGS=$LEG NUMBA_NUM_THREADS=${NUMBA_NUM_THREADS:-1}
FIGURE=${FIGURE-train.speed} BESIDE=${BESIDE:-} EXAMS_UNTIL=${EXAMS_UNTIL:-}
first=${LEG_LOTS:-a}
HOMES=${HOMES:-homes-${first%% *} $([ "${EXAMINED:-}" = 0 ] || echo homes-exam)}
LATER=("homes-*")  # made while it learns, those of the leg first
[ -z "${LEG_LOTS:-}" ] || read -ra LATER <<< "$(printf 'homes-%s ' $LEG_LOTS)"
[ -z "$EXAMS_UNTIL" ] || LATER+=(homes-exam homes-b known ${IMPORTED:+imported})
if [ -n "${WHEELS:-}" ]; then
  WHEELS=$(cd "$WHEELS" && pwd)
  export WHEELS
fi
. runs/offline.sh
open_offline "$OUT/site" || exit 1

quickest() { # words of the speed with most samples a second, of those that need no trying out of products
  "$PYTHON" - "$OUT/figures/train.speed/figures.json" <<'END'
import json, re, sys
found = {}
try:
    for figure in json.load(open(sys.argv[1])):
        for row in figure["rows"]:
            named = re.search(r"--speed (\S+)", row["detail"])
            if named and not named[1].startswith("tuned"):
                found[named[1]] = row["value"]
except (OSError, ValueError):
    pass
print(max(found, key=found.get) if found else "blocks")
END
}

beside() { # figures on the second card, each by itself: one that breaks off takes no other with it
  local one
  export CUDA_VISIBLE_DEVICES=1
  for one in $BESIDE; do "$PYTHON" -m gn0 figures "$one" --out "$OUT/figures/$one" > "$OUT/figures/$one.log" 2>&1; done
}

bring_home() {
  POLICY=shipped-$LEG runs/ablation.sh "$OUT" "$SIZE" pack
}

examine() { # until then, in all its ways, three walks a card side by side
  local left=$((EXAMS_UNTIL - $(date +%s))) cards=${GPUS-} card thrice=
  [ "$left" -gt 0 ] || return 0
  [ -n "${GPUS+x}" ] || cards=$(nvidia-smi --query-gpu=index --format=csv,noheader 2> /dev/null | paste -sd, -) || cards=
  for card in ${cards//,/ }; do thrice+=,$card,$card,$card; done
  GPUS=${thrice#,} WALL=$(awk -v left="$left" 'BEGIN {print left / 60}') NUMBA_NUM_THREADS=4 \
    runs/ablation.sh "$OUT" "$SIZE" 'shipped-*.walks' 'shipped-*.controls' 'shipped-*.known'
}

set -m  # all of it is one process group, which ends with this script
{
  set +m
  # shellcheck disable=SC2086
  runs/ablation.sh "$OUT" "$SIZE" $HOMES &
  homes=$!
  [ -z "$FIGURE" ] || [ -f "$OUT/figures/$FIGURE/figures.json" ] ||
    timeout --foreground "${SECONDS_OF_FIGURE:-290}" "$PYTHON" -m gn0 figures "$FIGURE" --out "$OUT/figures/$FIGURE"
  SPEED=${SPEED:-$(quickest)}
  export SPEED
  echo "speed $SPEED"
  wait "$homes" || exit 1
  if [ -n "$BESIDE" ]; then
    export GPUS=0
    beside &
  fi
  runs/ablation.sh "$OUT" "$SIZE" "shipped-$LEG" "${LATER[@]}"
  [ -f "$OUT/jobs/shipped-$LEG.done" ] || exit 1
  bring_home || exit 1
  if [ -n "$EXAMS_UNTIL" ]; then
    examine
    bring_home
  fi
} > >(tee "$OUT/leg.log") 2>&1 &
leg=$!
trap 'kill -- "-$leg" 2> /dev/null; wait; exit 130' INT TERM
wait "$leg"
