#!/usr/bin/env bash
# The ablation as a chain of jobs. Each is journalled, and resumable where it was cut; one that is done is never run
# again. Give the same command again after any interruption. docs/ablation.md says what the study is and how it is read.
#
#   runs/ablation.sh OUT                           everything, in the order of the table below, on all cards
#   runs/ablation.sh OUT tiny                      the same in miniature, models of 2 M weights, on a CPU
#   runs/ablation.sh OUT full plan                 the table: what is done, failed, cut or still to be done
#   runs/ablation.sh OUT full 'all-*-0*'           some jobs, by name or pattern, in the order they are given in, and what they
#                                                  are made from
#   runs/ablation.sh OUT full watch                how the jobs of a call that runs in the background are going, each minute
#   runs/ablation.sh OUT full pack                 what travels home: tables and logs, and the weights of one policy
#
# Environment:
#   PYTHON    interpreter (python3)
#   WHEELS    folder of wheels that a machine without a network lacks; they are unpacked into OUT/site, and gn0 itself is
#             taken from this checkout
#   EACH      cards of a trunk or a leg (all), so that two of them may be trained side by side
#   ROUND_CARDS  cards of DAgger in rounds, and of SFT that goes on as long (1), which share each batch
#   GPUS      cards to use, as 0,1,2,3 (all that nvidia-smi lists; none: jobs run one after another on the CPU); 0,0,0 runs
#             three jobs side by side on one, which walks have room for; with EACH=2 a trunk has two of these three places, so
#             that no two trunks meet on the card and walks go on beside each
#   MINUTES   of a training job at most (9; 0 for none); its rate falls in time. DAgger in rounds and RL count otherwise
#   LEG_MINUTES  of a leg of the chain (as MINUTES); UNTIL: seconds since 1970 by which its training ends, whatever came
#             before it took
#   WALL      minutes after which this call stops what runs, to be gone on with in the next; of `watch`: after which it
#             looks no longer (0: never)
#   INPUTS    that have arms (all views maps; in miniature maps): all is view, mosaic, near and far map; views is view and
#             mosaic; maps is near and far map
#   SEEDS     of the arms (0 1 2); episode RL has the first two
#   SAMPLES   of a trunk (8000000), STATES of a DAgger stage (300000, five times over), UPDATES of episode RL (200)
#   EPISODES  of an examination (all: 24 in each of 100 homes never seen)
#   EXAMINED  walks of a training run's own examination, before it and after it (512; 0: its 4,096 states alone, and of a
#             leg none at all, so that it does not wait for homes never seen)
#   BATCH, RATE  of the trunks, where the sweep found better ones than the recipe's; RATE of the legs, too (from the second
#             on 5e-4: what begins from weights alone is no fine-tuning)
#   SPEED     of SFT and DAgger, as `--speed` of `gn0 train sft` has it
#   JOINS     samples at which lots a, b and c join (0,500000,3000000); none: a leg of the chain begins with all of them
#   JOIN_LATE  1: a leg does not wait for a lot that is late, but takes it up when it is there
#   LOT_C     flats, apartments and houses of lot c (150 76 26)
#   LOT_D     the same of a lot that legs of the chain alone have, of what they find hard (none); it joins with lot c. Four
#             numbers more add large apartments, medium residences, small offices and small corridors: 90 60 40 20 20 10 10,
#             and two more medium apartments and small residences of an open plan
#   LOT_E     another such lot, of other homes (none)
#   LOT_MARK  a word behind the names of lots d and e, whose homes are others than those of another mark (none)
#   LEG_LOTS  lots that these legs learn in (a b c, and d and e where there are such), as "a b e"
#   PATHS     walks a home to train in (40), EXAM_PATHS: a home never seen (8), each told in three ways
#   WORKERS   homes made at a time (all cores but one)
#   LEGS      jobs of the chain for the policy in the box (8); FROM, LEG: the policy that leg LEG goes on from, where
#             earlier legs were made elsewhere
#   MIX       inputs of these legs, with their shares (all:0.5,views:0.3,maps:0.2); the next leg may have others:
#             MIX=maps:1 runs/ablation.sh OUT full shipped-1, then without MIX, shipped-2
#   BETA_TO   samples from which the policy alone drives in a leg that goes on (2000000 in the second, 1 in later ones)
#   INSIDE    metres that labels of legs go into a room that is the goal (0)
#   DRAW_AFTER  actions that lead nowhere after which answers are drawn in these legs, when it drives, too (6; 0: never)
#   IMPORTED  folder of a world or scene that is an exam of its own
#   POLICY    run whose weights are packed (the last leg that there is)
set -euo pipefail

OUT=${1:?usage: runs/ablation.sh OUT [tiny|full] [plan|pack|JOB ...]}
SIZE=${2:-full}
shift $(($# < 2 ? $# : 2))
WHAT=("${@:-*}")
PYTHON=${PYTHON:-python3}
MINUTES=${MINUTES:-9} WALL=$(awk -v minutes="${WALL:-0}" 'BEGIN {print int(60 * minutes)}')  # seconds
read -ra INPUTS <<< "${INPUTS:-$([ "$SIZE" = tiny ] && echo maps || echo all views maps)}"
read -ra SEEDS <<< "${SEEDS:-0 1 2}"
MIX=${MIX:-all:0.5,views:0.3,maps:0.2}
LEGS=${LEGS:-8} LEG=${LEG:-1} FROM=${FROM:-} DRAW_AFTER=${DRAW_AFTER:-6}
TRUNK_JOINS=${JOINS:-}
[ "$TRUNK_JOINS" != none ] || TRUNK_JOINS=
WORKERS=${WORKERS:-$(($(nproc) > 1 ? $(nproc) - 1 : 1))}
HERE=$(cd "$(dirname "$0")" && pwd)
case $SIZE in tiny | full) ;; *) echo "sizes are tiny and full, not $SIZE" >&2; exit 2 ;; esac
if [ -z "${GPUS+x}" ]; then
  GPUS=$(nvidia-smi --query-gpu=index --format=csv,noheader 2> /dev/null | paste -sd, -) || GPUS=
fi
[ "$SIZE" = full ] || GPUS=
IFS=, read -ra CARDS <<< "$GPUS"
mkdir -p "$OUT"/{specs,homes,suites,runs,walks,jobs,log}
if [ -n "${WHEELS:-}" ]; then
  . "$HERE/offline.sh"
  open_offline "$(cd "$OUT" && pwd)/site" || exit 1
fi

gn0() { "$PYTHON" -m gn0 "$@"; }
say() { printf '%s %s\n' "$(date -u +%FT%TZ)" "$*" | tee -a "$OUT/journal"; }

# ---- sizes: what each kind of job is given

within=()
[ "$MINUTES" = 0 ] || within=(--minutes "$MINUTES")
if [ "$SIZE" = tiny ]; then
  LOTS=("a train 2 0 0" "exam val_unseen 1 0 0" "b train 1 0 0")
  SUITES=("$OUT/suites/a" "$OUT/suites/b") joins=${JOINS:-0,32}
  small=(--report 2 --save 4 --examined 2 --asked 32 --device host)
  SFT=(--size nano --samples "${SAMPLES:-96}" --batch 16 --agents 16 --kept 320 --joins "${TRUNK_JOINS:-0,64}" "${small[@]}")
  FIRST=(--size nano --samples "${SAMPLES:-96}" --batch 16 --agents 16 --kept 320 "${small[@]}")  # of one lot
  ROUND=(--states "${STATES:-64}" --epochs 1 --batch 16 --agents 8 "${small[@]}")
  AGAIN=()
  LIVE=(--samples 64 --batch 16 --agents 16 --kept 320 --beta-from 0 --beta-to 32 "${small[@]}")
  NEW=(--size nano --samples 96 --batch 16 --agents 16 --kept 320 --beta-from 32 --beta-to 64 "${small[@]}")
  DAPO=(--states 32 --prompts 8 --answers 4 --minibatches 2 --epochs 1 --agents 8 --report 1 --save 2 --examined 2 --asked 32 --device host)
  RL=(--updates "${UPDATES:-2}" --episodes 2 --group 4 --max-steps 24 --batch 16 --minibatches 2 --save 1 --examined 2 --asked 32 --device host)
  BASELINE=(--size nano --samples 64 --agents 4 --steps 8 --rounds 1 --report 1 --save 1 --examined 2 --device host)
  WALK=(--episodes "${EPISODES:-2}" --agents 2 --device host)
  UNTRAINED=(--limit 4)
else
  LOTS=("a train 30 14 4" "exam val_unseen 60 30 10" "b train 60 30 10" "c train ${LOT_C:-150 76 26}")
  SUITES=("$OUT/suites/a" "$OUT/suites/b" "$OUT/suites/c") joins=${JOINS:-0,500000,3000000}
  own=(--examined "${EXAMINED:-512}" --shard-mb 15) kept=(--save 500 "${own[@]}")
  SFT=(--samples "${SAMPLES:-8000000}" --joins "${TRUNK_JOINS:-0,500000,3000000}" "${within[@]}" "${kept[@]}")
  FIRST=(--samples "${SAMPLES:-8000000}" "${within[@]}" "${kept[@]}")
  ROUND=(--states "${STATES:-300000}" --epochs 5 "${kept[@]}")
  LIVE=(--samples 1500000 --beta-from 0 --beta-to 500000 "${within[@]}" "${kept[@]}")
  NEW=(--samples 50000000 --beta-from 250000 --beta-to 2500000 "${within[@]}" "${kept[@]}")
  AGAIN=(--samples 50000000 --rate "${RATE:-5e-4}" --confirm-stop)  # of a leg that goes on
  DAPO=("${within[@]}" --save 50 "${own[@]}")
  RL=(--updates "${UPDATES:-200}" --save 3 "${own[@]}")
  BASELINE=(--samples "${SAMPLES:-8000000}" "${within[@]}" --agents 256 --steps 16)
  WALK=(--episodes "${EPISODES:-0}")
  UNTRAINED=()
fi
EXTRA=()  # lots that legs of the chain alone have
[ -z "${LOT_D:-}" ] || EXTRA+=("d train $LOT_D")
[ -z "${LOT_E:-}" ] || EXTRA+=("e train $LOT_E")
LEG_LOTS=${LEG_LOTS:-$(echo "${SUITES[@]##*/}" "${EXTRA[@]%% *}")}
LEG_SUITES=()
for one in $LEG_LOTS; do LEG_SUITES+=("$OUT/suites/$one"); done
if [ -z "${JOINS:-}" ]; then  # what is beyond lot c joins with it: scenes open once
  joins=$(awk -v all="$joins" -v lots=${#LEG_SUITES[@]} 'BEGIN {
    count = split(all, at, ",")
    for (k = 1; k <= lots; k++) printf "%s%s", (k > 1 ? "," : ""), at[k < count ? k : count]
  }')
fi
if [ "$joins" != none ]; then
  joining=(--joins "$joins")
  [[ -z ${JOIN_LATE:-} || $joins != *,* ]] || joining+=(--join-late)  # of one lot, nothing joins
  AGAIN+=("${joining[@]}")
  NEW+=("${joining[@]}")
fi
if [ -n "${INSIDE:-}" ]; then
  AGAIN+=(--inside "$INSIDE")
  NEW+=(--inside "$INSIDE")
fi
if [ -n "${SPEED:-}" ]; then
  for kind in SFT FIRST ROUND LIVE NEW; do
    declare -n flags=$kind
    flags+=(--speed "$SPEED")
  done
  unset -n flags
fi
[ -z "${BATCH:-}" ] || { SFT+=(--batch "$BATCH"); NEW+=(--batch "$BATCH"); }
[ -z "${RATE:-}" ] || { SFT+=(--rate "$RATE"); NEW+=(--rate "$RATE"); }

pictures() { # INPUT: flags of what a policy is shown
  case $1 in
    all) echo --pictures rgb,history,near,far --points 13 ;;
    views) echo --pictures rgb,history --points 0 ;;
    maps) echo --pictures near,far --points 13 ;;
    *) echo "inputs are all, views and maps, not $1" >&2; return 2 ;;
  esac
}

# ---- kinds of jobs; each may be begun again after it was cut

train() { # VERB RUN [FLAG ...]: on as many cards as the job was given
  local verb=$1 run=$2 count
  shift 2
  count=$(awk -F, '{print NF}' <<< "${CUDA_VISIBLE_DEVICES:-}")
  if [ "$count" -gt 1 ]; then
    # without the -- torchrun takes --start for its own
    "$PYTHON" -m torch.distributed.run --standalone --nproc-per-node "$count" -m -- gn0 train "$verb" "$@" --out "$OUT/runs/$run"
  else
    gn0 train "$verb" "$@" --out "$OUT/runs/$run"
  fi
}

sft() { # RUN INPUT SEED [FLAG ...]
  local run=$1 seed=$3 shown
  shown=$(pictures "$2")
  shift 3
  # shellcheck disable=SC2086
  train sft "$run" "${SUITES[@]}" --exam "$OUT/suites/exam" --text-length 120 $shown --seed "$seed" "${SFT[@]}" "$@"
}

few() { # RUN INPUT SEED LOTS [FLAG ...]: on the first so many lots alone
  local run=$1 seed=$3 count=$4 shown
  shown=$(pictures "$2")
  shift 4
  # shellcheck disable=SC2086
  train sft "$run" "${SUITES[@]:0:count}" --exam "$OUT/suites/exam" --text-length 120 $shown --seed "$seed" "${FIRST[@]}" "$@"
}

after_trunk() { # VERB RUN START SEED [FLAG ...]
  local verb=$1 run=$2 start=$OUT/runs/$3/policy seed=$4
  shift 4
  train "$verb" "$run" "${SUITES[@]}" --start "$start" --exam "$OUT/suites/exam" --seed "$seed" "$@"
}

baseline() { # RUN [FLAG ...]
  local run=$1
  shift
  train baseline "$run" "${SUITES[@]}" --exam "$OUT/suites/exam" "${BASELINE[@]}" "$@"  # all of its words are read
}

walk() { # NAME RUN SUITE SPLIT EXAM [FLAG ...]
  local name=$1 run=$2 suite=$3 split=$4 exam=$5
  shift 5
  gn0 policy examine "$OUT/runs/$run/policy" "$OUT/suites/$suite" --split "$split" --out "$OUT/walks/$name/$exam" "${WALK[@]}" "$@"
}

walks() { # RUN: the exams of a policy
  walk "$1" "$1" exam val_unseen unseen
  walk "$1" "$1" b val_seen seen
  [ ! -f "$OUT/suites/imported/manifest.json" ] || walk "$1" "$1" imported all imported
}

drawn() { # RUN: the first exam again, as what lies in the box walks it: a policy that turns to and fro gets out of it
  walk "$1" "$1" exam val_unseen drawn --draw-after "$DRAW_AFTER"
}

controls() { # RUN: without words, with others', without pictures, in phrasings that training knows
  local one
  for one in no_words shuffled no_pictures; do walk "$1-$one" "$1" exam val_unseen unseen --control "$one"; done
  walk "$1" "$1" known val_unseen known
}

executed() { # RUN: one action of an answer, all six, or those that lead along its waypoints
  walk "$1-executed_1" "$1" exam val_unseen unseen --executed 1
  walk "$1-executed_6" "$1" exam val_unseen unseen --executed 6
  walk "$1-carried_waypoints" "$1" exam val_unseen unseen --carried waypoints
}

bench() { # NAME POLICY [FLAG ...]: by the benchmark, whatever the policy
  local name=$1 policy=$2
  shift 2
  gn0 bench run "$OUT/suites/exam" --policy "$policy" --no-report --out "$OUT/walks/$name-0/unseen" "$@"
}

untrained() {
  local one
  for one in random straight wall_follower oracle parse_then_astar; do bench "$one" "$one" --workers "$WORKERS" "${UNTRAINED[@]}"; done
}

leg_minutes() { # flags of a leg's length
  local most=${LEG_MINUTES:-$MINUTES} left
  [ "$SIZE" = full ] || return 0
  if [ -n "${UNTIL:-}" ]; then
    left=$((UNTIL - $(date +%s)))
    most=$(awk -v left="$left" -v most="$most" 'BEGIN {left = left > 60 ? left / 60 : 1; print most == 0 || left < most ? left : most}')
  fi
  [ "$most" = 0 ] || echo "--minutes $most"
}

shipped() { # LEG: one policy for all inputs, live; goes on from the weights of the leg before, wherever they were made
  local leg=$1 start=$OUT/runs/shipped-$(($1 - 1))/policy exam=(--exam "$OUT/suites/exam")
  [ "${EXAMINED:-}" != 0 ] || exam=(--held-out "")
  [ "$leg" != "$LEG" ] || [ -z "$FROM" ] || start=$FROM
  if [ "$leg" = 1 ] && [ -z "$FROM" ]; then
    train dagger "shipped-1" "${LEG_SUITES[@]}" --live "${exam[@]}" --text-length 120 --inputs "$MIX" --seed 1 --jitter --draw-after "$DRAW_AFTER" "${NEW[@]}" $(leg_minutes)
  else
    train dagger "shipped-$leg" "${LEG_SUITES[@]}" --live --start "$start" "${exam[@]}" --text-length 120 --inputs "$MIX" --seed "$leg" --jitter --draw-after "$DRAW_AFTER" "${LIVE[@]}" \
      "${AGAIN[@]}" $([ "$SIZE" = tiny ] || echo --beta-to "${BETA_TO:-$((leg == 2 ? 2000000 : 1))}" $(leg_minutes))
  fi
  ln -sfn "shipped-$leg" "$OUT/runs/shipped"  # the last leg, whichever it is
}

asked_in() { # INPUT: the flag that asks a leg in one of its ways; a leg of one input has no other
  [ "${MIX%%:*}" = "$1" ] && [[ $MIX != *,* ]] || echo --inputs "$1"
}

shipped_walks() { # RUN INPUT
  walk "shipped-$2" "$1" exam val_unseen unseen $(asked_in "$2")
  walk "shipped-$2" "$1" b val_seen seen $(asked_in "$2")
  [ ! -f "$OUT/suites/imported/manifest.json" ] || walk "shipped-$2" "$1" imported all imported $(asked_in "$2")
}

shipped_controls() { # RUN INPUT
  local one
  for one in no_words shuffled; do walk "shipped-$2-$one" "$1" exam val_unseen unseen $(asked_in "$2") --control "$one"; done
}

legs_walks() { # LEG: on one input
  local one run=shipped-$1 name=legs$1-maps
  walk "$name" "$run" exam val_unseen unseen
  walk "$name" "$run" b val_seen seen
  for one in no_words shuffled; do walk "$name-$one" "$run" exam val_unseen unseen --control "$one"; done
}

lot() { # NAME SPLIT FLATS HOMES HOUSES [LARGE VILLAS OFFICES CORRIDORS OPEN_HOMES OPEN_HOUSES]
  local spec=$OUT/specs/$1.yaml
  [ ! -f "$OUT/suites/$1/manifest.json" ] || return 0
  {
    printf 'name: lot-%s\nseed: 21\nval_seen: 1.0\nheld_out: {styles: [classic, dark modern], variants: 0.25}\nparts:\n' "$1"
    part() { [ "$2" = 0 ] || printf '  - {%s, count: %s, density: 2500, light: draft, split: %s, name: %s}\n' "$3" "$2" "$SPLIT" "$1"; }
    SPLIT=$2
    local named=$1  # a home is of the name of its part
    [[ $1 != [de] ]] || named+=${LOT_MARK:-}
    part "$named-flat" "$3" "kind: apartment, size: small"
    part "$named-home" "$4" "kind: apartment, size: medium"
    part "$named-house" "$5" "kind: residence, size: small"
    part "$named-large" "${6:-0}" "kind: apartment, size: large"
    part "$named-villa" "${7:-0}" "kind: residence, size: medium"
    part "$named-office" "${8:-0}" "kind: office, size: small"
    part "$named-corridor" "${9:-0}" "kind: corridor, size: small"
    part "$named-open" "${10:-0}" "kind: apartment, size: medium, open_plan: true"
    part "$named-loft" "${11:-0}" "kind: residence, size: small, open_plan: true"
  } > "$spec"
  export NUMBA_NUM_THREADS=1
  local skip=  # one home less to learn in is no harm; the exam is what it is said to be
  [ "$2" != train ] || skip=--skip-failed
  gn0 scene corpus --spec "$spec" --out "$OUT/homes/$1" --workers "$WORKERS" $skip --no-sheet
  missions "$OUT/homes/$1" "$1"
}

missions() { # SCENES SUITE [FLAG ...]
  local scenes=$1 suite=$2 paths=${PATHS:-40}
  shift 2
  case $suite in exam | known) paths=${EXAM_PATHS:-8} ;; esac
  [ "$SIZE" = full ] || paths=${PATHS:-8}
  gn0 missions generate "$scenes" --spec "$HERE/ablation/missions.yaml" --camera tiny_128 --seed 21 \
    --per-scene "$paths" --workers "$WORKERS" --out "$OUT/suites/$suite" "$@"
}

imported() {
  [ -f "$OUT/homes/imported/scene.json" ] || gn0 scene import "$IMPORTED" --out "$OUT/homes/imported"
  missions "$OUT/homes/imported" imported
}

study() {
  local code=0
  gn0 policy study "$HERE/ablation/study.yaml" "$OUT" --out "$OUT/ablation.md" || code=$?
  [ "$SIZE" = full ] || [ $code -gt 1 ] ||  # what the full study found, and lacks, is not said of it
    sed -i -e '/^### What it says so far/,/^In miniature/{/^In miniature/!d}' -e '/^\* \*\*Shortfalls/,/^\* \*\*One rule/{/^\* \*\*One rule/!d}' \
      -e '1a \\n**In miniature: models of 2 M weights, a handful of homes and of walks. No number here means anything.**' "$OUT/ablation.md"
  return $code
}

# ---- the table: name, what must be done before (commas between), cards, what to do; of jobs under one pattern, what
# stands first goes first, of those that need not wait

NAMES=()
declare -A AFTER=() NEEDS=() DOES=()
job() {
  NAMES+=("$1")
  AFTER[$1]=${2//,/ } NEEDS[$1]=$3
  shift 3
  DOES[${NAMES[-1]}]="$*"
}

SHARE=$(($(nproc) > ${#CARDS[@]} && ${#CARDS[@]} > 0 ? $(nproc) / ${#CARDS[@]} : 1))  # cores of a card
ALL=${EACH:-$((${#CARDS[@]} > 1 ? ${#CARDS[@]} : 1))}  # cards of a trunk
ROUNDS=${ROUND_CARDS:-1}
rest=$(printf ',homes-%s' "${LOTS[@]%% *}")
rest=${rest:1}
chain_rest=$(printf ',homes-%s' $LEG_LOTS)
chain_rest=${chain_rest:1}
[ "${EXAMINED:-}" = 0 ] || chain_rest=homes-exam,$chain_rest

arms() { # INPUT SEED: a cell, a trunk and then its arms side by side
  local cell=$1 seed=$2
  job "$cell-sft-$seed" homes-a "$ALL" sft "$cell-sft-$seed" "$cell" "$seed"
  job "$cell-longer-$seed" "$cell-sft-$seed,$rest" "$ROUNDS" after_trunk dagger "$cell-longer-$seed" "$cell-sft-$seed" "$seed" --driver expert "${ROUND[@]}"
  job "$cell-dagger-$seed" "$cell-sft-$seed,$rest" "$ROUNDS" after_trunk dagger "$cell-dagger-$seed" "$cell-sft-$seed" "$seed" "${ROUND[@]}"
  job "$cell-dapo-$seed" "$cell-sft-$seed,$rest" 1 after_trunk dapo "$cell-dapo-$seed" "$cell-sft-$seed" "$seed" "${DAPO[@]}"
  job "$cell-live-$seed" "$cell-sft-$seed,$rest" 1 after_trunk dagger "$cell-live-$seed" "$cell-sft-$seed" "$seed" --live "${LIVE[@]}"
  job "$cell-dagger_dapo-$seed" "$cell-dagger-$seed" 1 after_trunk dapo "$cell-dagger_dapo-$seed" "$cell-dagger-$seed" "$seed" "${DAPO[@]}"
  local arm
  for arm in sft longer dagger dapo live dagger_dapo; do
    job "$cell-$arm-$seed.walks" "$cell-$arm-$seed,$rest" 1 walks "$cell-$arm-$seed"
    job "$cell-$arm-$seed.drawn" "$cell-$arm-$seed,homes-exam" 1 drawn "$cell-$arm-$seed"
  done
  for arm in dagger_dapo live; do
    job "$cell-$arm-$seed.controls" "$cell-$arm-$seed,known" 1 controls "$cell-$arm-$seed"
  done
}

row() { # NAME WHAT ...: a trunk of the input `all` with something else, one seed
  local name=$1
  shift
  job "$name-0" homes-a "$ALL" "$1" "$name-0" all 0 "${@:2}"
  job "$name-0.walks" "$name-0,$rest" 1 walks "$name-0"
}

# 1. scenes and missions, made beside the learner; nobody waits for more than lot a
for one in "${LOTS[@]}" "${EXTRA[@]}"; do job "homes-${one%% *}" "" 0 lot $one; done
job known homes-exam 0 missions "$OUT/homes/exam" known --phrasings known
[ -z "${IMPORTED:-}" ] || job imported homes-exam 0 imported
job untrained homes-exam 0 untrained

# 2. never dropped: one cell with all its arms and controls, then the policy in the box, then the other seeds
for input in "${INPUTS[@]}"; do arms "$input" "${SEEDS[0]}"; done
for ((leg = LEG; leg <= LEGS; leg++)); do
  before=homes-${LEG_LOTS%% *}  # all others join
  [ "${EXAMINED:-}" = 0 ] || before+=,homes-exam
  [ "$leg" -gt "$LEG" ] && before=shipped-$((leg - 1)),$chain_rest
  job "shipped-$leg" "$before" "$ALL" shipped "$leg"
done
for ((leg = LEG > 2 ? LEG : 2; leg <= (LEGS < 3 ? LEGS : 3); leg++)); do
  job "legs$leg.walks" "shipped-$leg,$rest" 1 legs_walks "$leg"
  job "legs$leg.known" "shipped-$leg,known" 1 walk "legs$leg-maps" "shipped-$leg" known val_unseen known
done
for input in all views maps; do
  job "shipped-$input.walks" "shipped-$LEGS,homes-exam,homes-b" 1 shipped_walks "shipped-$LEGS" "$input"
  job "shipped-$input.controls" "shipped-$LEGS,homes-exam" 1 shipped_controls "shipped-$LEGS" "$input"
  job "shipped-$input.known" "shipped-$LEGS,known" 1 walk "shipped-$input" "shipped-$LEGS" known val_unseen known $(asked_in "$input")
done
for seed in "${SEEDS[@]:1}"; do arms "${INPUTS[0]}" "$seed"; done

# 3. the recipe, baselines and the ceiling of perception
for batch in 512 2048; do
  for rate in 4e-4 1e-3; do
    job "sweep-$batch-$rate" homes-a 1 sft "sweep-$batch-$rate" maps 0 --batch "$batch" --rate "$rate" $([ "$SIZE" = tiny ] || echo --minutes 8)
  done
done
for one in "cma_views --pictures rgb,depth" "cma_maps --pictures rgb,depth,near" "cma_blind --model cma_blind" "seq2seq --model seq2seq"; do
  job "${one%% *}-0" "$rest" 1 baseline "${one%% *}-0" ${one#* }
  job "${one%% *}-0.walks" "${one%% *}-0,homes-exam" 1 walk "${one%% *}-0" "${one%% *}-0" exam val_unseen unseen
done
for input in "${INPUTS[@]}"; do  # DAgger once, of states that are less alike
  spread=$input-dagger_spread-${SEEDS[0]} trunk=$input-sft-${SEEDS[0]}
  job "$spread" "$trunk,$rest" 1 after_trunk dagger "$spread" "$trunk" "${SEEDS[0]}" "${ROUND[@]}" --rescue 16 $([ "$SIZE" = tiny ] || echo --agents 4096)
  job "$spread.walks" "$spread,$rest" 1 walks "$spread"
  job "$spread.drawn" "$spread,homes-exam" 1 drawn "$spread"
done
row unchanged sft  # what the other rows are measured by
row oracle_map sft --map-paint categories
row paper_inputs sft --without paper
row uniform sft --source uniform
row scenes_50 few 1
job executed "${INPUTS[0]}-dagger_dapo-${SEEDS[0]},$rest" 1 executed "${INPUTS[0]}-dagger_dapo-${SEEDS[0]}"

# 4. dropped if time runs out, the last first
for seed in "${SEEDS[@]:0:2}"; do
  job "${INPUTS[0]}-rl-$seed" "${INPUTS[0]}-live-$seed" 1 after_trunk rl "${INPUTS[0]}-rl-$seed" "${INPUTS[0]}-live-$seed" "$seed" "${RL[@]}"
  job "${INPUTS[0]}-rl-$seed.walks" "${INPUTS[0]}-rl-$seed" 1 walks "${INPUTS[0]}-rl-$seed"
done
row json sft --layout json
job json_dapo-0 "json-0,$rest" 1 after_trunk dapo json_dapo-0 json-0 0 --sampling free "${DAPO[@]}"
job json_dapo-0.walks json_dapo-0 1 walks json_dapo-0
for input in "${INPUTS[@]:1}"; do
  for seed in "${SEEDS[@]:1}"; do arms "$input" "$seed"; done
done
row scenes_150 few 2
row heading sft --without heading
row waypoints sft --points 0
row key_order sft --order actions_first
row global_maps sft --inputs paper_planning --text-length 300

# ---- running it

is_done() { # JOB; homes that lie on another machine are made again
  [ -f "$OUT/jobs/$1.done" ] || return 1
  case $1 in
    homes-*) [ -f "$OUT/suites/${1#homes-}/manifest.json" ] ;;
    known) [ -f "$OUT/suites/known/manifest.json" ] ;;
  esac
}

state() { # JOB
  local one
  if is_done "$1"; then echo "done"; return; fi
  for one in failed cut; do
    [ ! -f "$OUT/jobs/$1.$one" ] || { echo "$one"; return; }
  done
  echo "to do"
}

plan() {
  local name
  printf '%-9s %-28s %-5s %s\n' state job cards after
  for name in "${NAMES[@]}"; do
    printf '%-9s %-28s %-5s %s\n' "$(state "$name")" "$name" "${NEEDS[$name]}" "${AFTER[$name]}"
    [ ! -f "$OUT/jobs/$name.failed" ] || printf '          %s\n' "$(cat "$OUT/jobs/$name.failed")"
  done
}

pack() { # tables and logs in pieces of 15 MB, and one set of weights
  local run=${POLICY:-} leg new=$OUT/pack.new  # what was packed before lies there until all of it is new
  if [ -z "$run" ]; then
    for ((leg = LEGS; leg > 0; leg--)); do [ ! -d "$OUT/runs/shipped-$leg/policy" ] || { run=shipped-$leg; break; }; done
  fi
  rm -rf "$new"
  mkdir -p "$new"
  study > "$new/verdicts.txt" || true
  (cd "$OUT" && find . -type f \( -path './jobs/*' -o -path './log/*' -o -path './specs/*' -o -path './walks/*' -o -name ablation.md \
    -o -path './runs/*/run.json' -o -path './runs/*/metrics.jsonl' -o -path './runs/*/page.html' -o -path './runs/*/log' -o -path ./journal \) \
    ! -path './runs/*/checkpoints/*' ! -name .lock ! -name trajectories.jsonl ! -name 'journal.jsonl' -print0 | sort -z |
    tar --null -czf - -T -) | split -b 15M - "$new/tables.tar.gz."
  [ -z "$run" ] || cp -r "$OUT/runs/$run/policy" "$new/policy"
  [ ! -d "$OUT/figures" ] || cp -r "$OUT/figures" "$new"  # of runs/leg.sh
  rm -rf "$OUT/pack"
  mv "$new" "$OUT/pack"
  say "packed $(du -sh "$OUT/pack" | cut -f1)${run:+, weights of $run}: $OUT/pack"
}

runs_now() { # whether a call works on these jobs
  [ -f "$OUT/pid" ] && kill -0 "$(cat "$OUT/pid")" 2> /dev/null
}

watch() { # last lines of what runs, until nothing does
  local log name
  goes_on() { runs_now && { [ "$WALL" = 0 ] || [ "$SECONDS" -lt "$WALL" ]; }; }
  while runs_now; do  # once at least, however soon its time is up
    for log in "$OUT"/log/*; do
      name=${log##*/}
      [ -f "$log" ] && [ ! -f "$OUT/jobs/$name.done" ] && [ ! -f "$OUT/jobs/$name.failed" ] && [ ! -f "$OUT/jobs/$name.cut" ] || continue
      printf '%s %s: %s\n' "$(date -u +%T)" "$name" "$(tail -n 1 "$log")"
    done
    for ((log = 0; log < 60; log++)); do
      goes_on || break
      sleep 1
    done
    goes_on || break
  done
  tail -n 12 "$OUT/journal"
}

declare -A CHOSEN=() PID=() SINCE=() HOLDS=() TRIED=()
ORDER=()
choose() { # JOB: behind all that it is made from
  local one
  [ -z "${CHOSEN[$1]:-}" ] || return 0
  CHOSEN[$1]=yes
  if is_done "$1"; then  # nor does what it was made from matter any more
    ORDER+=("$1")
    return 0
  fi
  local before=${AFTER[$1]}
  case ${DOES[$1]} in  # they join while it learns
    sft\ * | few\ *) before+=" ${rest//,/ }" ;;
    shipped\ *) before+=" ${chain_rest//,/ }" ;;
  esac
  for one in $before; do
    [ -n "${DOES[$one]:-}" ] || continue  # made elsewhere
    choose "$one"
  done
  ORDER+=("$1")
}

ready() { # JOB: 0 if all before it is done
  local one
  for one in ${AFTER[$1]}; do
    [ -z "${DOES[$one]:-}" ] || is_done "$one" || return 1
  done
}

begin() { # JOB CARDS: in a process group of its own
  rm -f "$OUT/jobs/$1".{done,failed,cut}
  say "begin $1${2:+ on card $2}"
  (
    export CUDA_VISIBLE_DEVICES=$(tr , '\n' <<< "$2" | awk '!seen[$0]++' | paste -sd,)  # several places on a card are one card
    if [ -n "$2" ]; then  # its share of the cores: four jobs that each took all of them opened 400 scenes in 190 s
      export NUMBA_NUM_THREADS=${NUMBA_NUM_THREADS:-$SHARE} OMP_NUM_THREADS=${OMP_NUM_THREADS:-$SHARE}
    fi
    [ -n "$2" ] || renice -n 10 -p "$BASHPID" > /dev/null 2>&1 || true  # homes give way to who learns
    set -euo pipefail
    ${DOES[$1]}
  ) >> "$OUT/log/$1" 2>&1 &
  PID[$1]=$! SINCE[$1]=$SECONDS HOLDS[$1]=$2
}

finish() { # JOB STATUS
  local name=$1 took=$((SECONDS - ${SINCE[$1]})) why
  if [ "$2" = 0 ]; then
    printf '%s %d s%s: %s\n' "$(date -u +%FT%TZ)" "$took" "${HOLDS[$name]:+ on card ${HOLDS[$name]}}" "${DOES[$name]}" > "$OUT/jobs/$name.done"
    say "done $name, $took s"
  elif [ "$2" = cut ]; then
    echo "after $took s of this call" > "$OUT/jobs/$name.cut"
    say "cut $name, $took s; the next call goes on with it"
  else
    why=$(grep -a 'gn0:\|Error\|→' "$OUT/log/$name" | tail -2 | tr '\n' ' ') || true  # one that was killed says nothing
    echo "status $2 after $took s: ${why:-see $OUT/log/$name}" > "$OUT/jobs/$name.failed"
    say "failed $name: $(cat "$OUT/jobs/$name.failed")"
  fi
  local card
  for card in ${HOLDS[$name]//,/ }; do FREE+=("$card"); done
  unset "PID[$name]"
}

run_jobs() {
  local name need taken cpu pattern matched held found=
  for pattern in "${WHAT[@]}"; do
    matched=
    for name in "${NAMES[@]}"; do
      # shellcheck disable=SC2053
      [[ $name != $pattern ]] || { choose "$name"; matched=yes; }
    done
    [ -n "$matched" ] || { echo "no job is named $pattern; see: $0 $OUT $SIZE plan" >&2; return 2; }
  done
  NAMES=("${ORDER[@]}") FREE=("${CARDS[@]}")
  local deadline=$((SECONDS + WALL)) failed=0
  while :; do
    for name in "${!PID[@]}"; do
      kill -0 "${PID[$name]}" 2> /dev/null && continue
      local status=0
      wait "${PID[$name]}" || status=$?
      finish "$name" "$status"
    done
    if [ "$WALL" != 0 ] && [ "$SECONDS" -ge "$deadline" ]; then
      for name in "${!PID[@]}"; do
        kill -- "-${PID[$name]}" 2> /dev/null || true
        wait "${PID[$name]}" 2> /dev/null || true
        finish "$name" cut
      done
      say "time is up; give the same command again to go on"
      return 3
    fi
    held= cpu=0 found=
    for name in "${!PID[@]}"; do [ "${NEEDS[$name]}" != 0 ] || cpu=$((cpu + 1)); done
    for name in "${NAMES[@]}"; do
      [ -n "${CHOSEN[$name]:-}" ] && [ -z "${PID[$name]:-}" ] && [ -z "${TRIED[$name]:-}" ] || continue
      is_done "$name" && continue
      ready "$name" || continue
      need=${NEEDS[$name]}
      if [ "$need" = 0 ]; then
        [ "$cpu" = 0 ] || continue
        cpu=1 taken=
      elif [ ${#CARDS[@]} = 0 ]; then # no cards: one after another
        [ ${#PID[@]} -gt "$cpu" ] && continue
        taken=
      else
        [ -z "$held" ] || continue
        if [ ${#FREE[@]} -lt "$need" ]; then held=yes; continue; fi # whoever stands first is not passed
        taken=$(IFS=,; echo "${FREE[*]:0:need}")
        FREE=("${FREE[@]:need}")
      fi
      TRIED[$name]=yes
      begin "$name" "$taken"
    done
    [ ${#PID[@]} -gt 0 ] || break
    sleep 0.1
  done
  for name in "${NAMES[@]}"; do
    [ -n "${CHOSEN[$name]:-}" ] && ! is_done "$name" || continue
    failed=$((failed + 1))
    [ -f "$OUT/jobs/$name.failed" ] || say "not begun $name: something before it is not done"
  done
  [ $failed = 0 ] || { say "$failed jobs are not done; see $0 $OUT $SIZE plan"; return 1; }
  say "all done"
}

case ${WHAT[0]} in
  plan) plan; exit ;;
  watch) watch; exit ;;
  pack) pack; exit ;;
  study) study; exit ;;
esac
if runs_now; then
  echo "process $(cat "$OUT/pid") works on these jobs; see: $0 $OUT $SIZE watch" >&2
  exit 2
fi
echo $$ > "$OUT/pid"
set -m # each job in a process group of its own, to be stopped as one
trap 'rm -f "$OUT/pid"; for name in "${!PID[@]}"; do kill -- "-${PID[$name]}" 2> /dev/null || true; done' EXIT
trap 'exit 130' INT TERM
run_jobs
