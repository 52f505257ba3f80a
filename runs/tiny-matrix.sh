#!/usr/bin/env bash
# The data half of the paper in miniature, on a CPU: scenes of every kind, missions, language, samples, recovery
# states, balancing, statistics, and every export. About ten minutes on two cores; `tiny-matrix.sh OUT ci` takes one.
set -euo pipefail

OUT=${1:-out/tiny-matrix}
SIZE=${2:-full}
WORKERS=${WORKERS:-2}
SEED=${SEED:-1}
mkdir -p "$OUT"

say() { printf '\n== %s (%d s)\n' "$1" "$SECONDS"; }

say "scenes"
if [ "$SIZE" = ci ]; then
  cat > "$OUT/corpus.yaml" <<END
name: tiny
seed: $SEED
splits: {train: 1.0}
parts:
  - {kind: apartment, size: small, density: 5000, light: draft}
END
  PATHS=3 FEW=3
else
  cat > "$OUT/corpus.yaml" <<END
name: tiny
seed: $SEED
val_seen: 0.2
parts:
  - {kind: office, size: small, density: 5000, light: draft, split: train}
  - {kind: supermarket, size: small, density: 5000, light: draft, split: train}
  - {kind: warehouse, size: small, density: 5000, light: draft, split: train}
  - {kind: residence, size: small, density: 5000, light: draft, split: train}
  - {kind: corridor, size: small, density: 5000, light: draft, split: val_unseen}
  - {kind: courtyard, size: small, density: 5000, light: draft, split: train}
END
  # the seventh: a house that nobody generated, where there is one
  if [ -d "${GN0_DATA:-../shared/data}/worlds/small_house" ]; then
    export GN0_DATA=$(realpath "${GN0_DATA:-../shared/data}")
    echo '  - {path: $GN0_DATA/worlds/small_house, density: 4000, split: test}' >> "$OUT/corpus.yaml"
  else
    echo '  - {kind: apartment, size: medium, density: 5000, light: draft, split: test}' >> "$OUT/corpus.yaml"
  fi
  PATHS=6 FEW=21
fi
gn0 scene corpus --spec "$OUT/corpus.yaml" --out "$OUT/corpus" --workers "$WORKERS"

say "missions and language"
gn0 missions generate "$OUT/corpus" --out "$OUT/missions" --per-scene "$PATHS" --lights 2 --seed "$SEED" --workers "$WORKERS"

say "samples"
gn0 data build "$OUT/missions" --out "$OUT/data" --workers "$WORKERS"
gn0 data verify "$OUT/data"

say "recovery states (DAgger)"
gn0 data dagger "$OUT/missions" --policy wall_follower --beta 0.5 --out "$OUT/dagger" --workers "$WORKERS"

say "balance and statistics"
gn0 data balance "$OUT/data" || echo "too few samples to balance exactly: the report says so"
gn0 data stats "$OUT/data"

say "every export"
# formats with pictures draw, encode and read back every frame: a few episodes show as much as all
few() { case $1 in gn-matrix* | vlnce-*) ;; *) echo "--limit $FEW" ;; esac; }
whole_turns() { case $1 in navid | uninavid) echo "--merge-turns" ;; esac; }  # these walks turn by 15°, its agent by 30°
for format in gn-matrix gn-matrix-json vlnce-r2r vlnce-rxr vln-pe interndata-n1 navdp lerobot-v3 \
    navid uninavid streamvln navila; do
  gn0 export "$format" "$OUT/data" --out "$OUT/export/$format" $(few "$format") $(whole_turns "$format")
  gn0 export check "$OUT/export/$format"
done

say "done: open $OUT/data/stats.html and $OUT/corpus/corpus.jpg"
