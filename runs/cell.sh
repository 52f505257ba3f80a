#!/usr/bin/env bash
# A cell of the study on a machine that is lent for half an hour, with nothing to decide in between: its trunk on all cards,
# DAgger and its control on all of them, then the other arms, and every walk as soon as there is a policy for it. Whenever a
# job has ended, tables and logs are packed, so that a machine that is taken back costs what ran then and no more.
#
#   runs/cell.sh OUT                            view, mosaic, near and far map: SFT, DAgger, DAPO, DAPO after DAgger
#   INPUT=views ARMS="dagger longer live dapo dagger_dapo" runs/cell.sh OUT
#   SIZE=tiny runs/cell.sh OUT                  a rehearsal on a CPU
#   WALL=9 runs/ablation.sh OUT full watch      how it is going, from another terminal
#
# Environment: that of runs/ablation.sh, and
#   SIZE      full, or tiny
#   INPUT     of the cell (all), SEED (0)
#   ARMS      beside the trunk (dagger dapo dagger_dapo); dagger and longer go before all others
#   MORE      jobs beside their walks, as "all-dagger_dapo-0.controls" (none)
#   TRUNK_UNTIL  seconds since 1970 by which the trunk ends (after MINUTES); a cell whose trunk is not done ends there
#   ARMS_UNTIL   by which arms end that have a clock (after MINUTES; DAgger in rounds and SFT as long have none)
#   OPENING   seconds of both that go into opening homes and compiling (65)
#   EXAMS_UNTIL  by which everything ends (never)
#   ROUND_CARDS  of DAgger in rounds, and of SFT as long (all)
#   PACK_EVERY   seconds between looks at whether a job has ended (15)
set -uo pipefail

OUT=${1:?usage: runs/cell.sh OUT}
cd "$(dirname "$0")/.."
mkdir -p "$OUT"
OUT=$(cd "$OUT" && pwd)
SIZE=${SIZE:-full} INPUT=${INPUT:-all} SEED=${SEED:-0} ARMS=${ARMS:-dagger dapo dagger_dapo} OPENING=${OPENING:-65}
TRUNK_UNTIL=${TRUNK_UNTIL:-} ARMS_UNTIL=${ARMS_UNTIL:-} EXAMS_UNTIL=${EXAMS_UNTIL:-}
if [ -z "${GPUS+x}" ]; then
  GPUS=$(nvidia-smi --query-gpu=index --format=csv,noheader 2> /dev/null | paste -sd, -) || GPUS=
fi
count=$(awk -F, '{print NF}' <<< "$GPUS")
export INPUTS=$INPUT SEEDS=$SEED ROUND_CARDS=${ROUND_CARDS:-$((count > 1 ? count : 1))} PYTHONUNBUFFERED=1
export WORKERS=${WORKERS:-$(($(nproc) > 3 ? $(nproc) - 3 : 1))}
[ -z "${WHEELS:-}" ] || { WHEELS=$(cd "$WHEELS" && pwd) && export WHEELS; }

left() { # SECONDS SINCE 1970: minutes until then, a second at least
  awk -v left=$(($1 - $(date +%s))) 'BEGIN {print (left > 1 ? left : 1) / 60}'
}

jobs_of() { # CARDS MINUTES JOB ...: until EXAMS_UNTIL
  GPUS=$1 MINUTES=$2 WALL=$([ -z "$EXAMS_UNTIL" ] || left "$EXAMS_UNTIL") runs/ablation.sh "$OUT" "$SIZE" "${@:3}"
}

clock() { # SECONDS SINCE 1970 or nothing: minutes of a job that begins now
  if [ -n "$1" ]; then left $(($1 - OPENING)); else echo "${MINUTES:-9}"; fi
}

pack() { POLICY='' runs/ablation.sh "$OUT" "$SIZE" pack > /dev/null; }

pack_whenever_a_job_ends() {
  local before=0 now
  while sleep "${PACK_EVERY:-15}"; do
    now=$(find "$OUT/jobs" -type f 2> /dev/null | wc -l)
    [ "$now" = "$before" ] || pack
    before=$now
  done
}

set -m  # all of it is one process group, which ends with this script
{
  set +m
  trunk=$INPUT-sft-$SEED
  walks=("$trunk".walks "$trunk".drawn) rounds=() later=()
  for arm in $ARMS; do
    walks+=("$INPUT-$arm-$SEED".walks "$INPUT-$arm-$SEED".drawn)
    case $arm in
      dagger) rounds=("$INPUT-$arm-$SEED" "${rounds[@]}") ;;
      longer) rounds+=("$INPUT-$arm-$SEED") ;;
      *) later+=("$INPUT-$arm-$SEED") ;;
    esac
  done
  pack_whenever_a_job_ends &
  packer=$!
  jobs_of "$GPUS" "${MINUTES:-9}" homes-a
  jobs_of "$GPUS" "$(clock "$TRUNK_UNTIL")" "homes-[bc]" "$trunk" homes-exam
  code=$?
  if [ -f "$OUT/jobs/$trunk.done" ]; then  # else the arms would begin it again, without its clock
    [ ${#rounds[@]} = 0 ] || jobs_of "$GPUS" 0 "${rounds[@]}"
    # two jobs a card side by side: walks leave room beside an arm
    # shellcheck disable=SC2086
    jobs_of "$GPUS${GPUS:+,$GPUS}" "$(clock "$ARMS_UNTIL")" "${later[@]}" "${walks[@]}" ${MORE:-}
    code=$?
  fi
  kill "$packer"
  wait "$packer"
  pack
  exit $code
} > >(tee "$OUT/cell.log") 2>&1 &
cell=$!
trap 'kill -- "-$cell" 2> /dev/null; wait; exit 130' INT TERM
wait "$cell"
