#!/usr/bin/env bash
# The training half of the paper in miniature, on a CPU: scenes, missions, samples, a tokenizer of their language, SFT of a model of
# 2 M weights, DAgger, once and live, DAPO, RL on whole episodes, and a recurrent baseline. Needs the extra `train`; about three minutes on two cores,
# `tiny-bae.sh OUT ci` one.
set -euo pipefail

OUT=${1:-out/tiny-bae}
SIZE=${2:-full}
WORKERS=${WORKERS:-2}
SEED=${SEED:-1}
mkdir -p "$OUT"

say() { printf '\n== %s (%d s)\n' "$1" "$SECONDS"; }

say "scenes"
PATHS=12
[ "$SIZE" = ci ] && PATHS=3
cat > "$OUT/corpus.yaml" <<END
name: tiny-bae
seed: $SEED
splits: {train: 1.0}
parts:
  - {kind: apartment, size: small, density: 5000, light: draft}
END
gn0 scene corpus --spec "$OUT/corpus.yaml" --out "$OUT/corpus" --workers "$WORKERS"

say "missions and samples"
gn0 missions generate "$OUT/corpus" --out "$OUT/missions" --per-scene "$PATHS" --camera tiny_128 --seed "$SEED" --workers "$WORKERS"
gn0 data build "$OUT/missions" --answer-order paper --out "$OUT/data" --workers "$WORKERS"
gn0 data balance "$OUT/data" || echo "too few samples to balance exactly"

say "tokenizer"
gn0 train tokenizer "$OUT/data" --merges 600 --out "$OUT/words"

say "SFT"
SAMPLES=1600
[ "$SIZE" = ci ] && SAMPLES=32
gn0 train sft "$OUT/missions" --split all --held-out "" --size nano --batch 16 --agents 16 --kept 320 --samples "$SAMPLES" \
  --inputs maps:0.7,near_alone=near/13:0.3 \
  --report 5 --device host --seed "$SEED" --out "$OUT/sft"
gn0 train sft "$OUT/data" --source dataset --held-out "" --size nano --batch 16 --samples 32 --seed "$SEED" --out "$OUT/sft-data"

say "DAgger"
STATES=160
[ "$SIZE" = ci ] && STATES=32
gn0 train dagger "$OUT/missions" --start "$OUT/sft/policy" --split all --held-out "" --states "$STATES" --epochs 2 --batch 16 --agents 16 \
  --report 5 --device host --seed "$SEED" --out "$OUT/dagger"
gn0 train dagger "$OUT/missions" --live --start "$OUT/sft/policy" --split all --held-out "" --samples "$STATES" --batch 16 --agents 16 --kept 320 \
  --beta-from 0 --beta-to 64 --report 5 --device host --seed "$SEED" --out "$OUT/dagger-live"

say "DAPO"
STATES=64
[ "$SIZE" = ci ] && STATES=16
gn0 train dapo "$OUT/missions" --start "$OUT/dagger/policy" --split all --held-out "" --states "$STATES" --agents 4 --epochs 1 \
  --prompts 8 --answers 4 --minibatches 2 --report 1 --device host --seed "$SEED" --out "$OUT/dapo"

say "RL on whole episodes"
UPDATES=4
[ "$SIZE" = ci ] && UPDATES=1
gn0 train rl "$OUT/missions" --start "$OUT/sft/policy" --split all --held-out "" --episodes 2 --group 4 --max-steps 12 --batch 16 \
  --updates "$UPDATES" --device host --seed "$SEED" --out "$OUT/rl"

say "a baseline"
BATCHES=6
[ "$SIZE" = ci ] && BATCHES=2
gn0 train baseline "$OUT/missions" --split all --held-out "" --size nano --pictures near --agents 4 --steps 8 --samples "$((BATCHES * 32))" \
  --rounds 1 --report 1 --device host --seed "$SEED" --out "$OUT/cma"
gn0 bench run "$OUT/missions" --policy cma --policy-option checkpoint="$OUT/cma/policy" --episodes 1 --no-report --out "$OUT/cma-bench"
