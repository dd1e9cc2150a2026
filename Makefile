# The commands of this project. `make demo` and `make test` need nothing but Python >= 3.11 and git.
BIN := .venv/bin

.PHONY: demo test proof bench lint setup samples wheel clean

demo: setup        ## slice a sample part with its painted fields and show where the result is
	$(BIN)/amslicer samples/insole/insole.stl --fields samples/insole/fields.yaml --printer generic-300dpi \
		--set printer.layer_um=100 -o demo-insole --overwrite
	$(BIN)/amslicer preview demo-insole

test: setup lint   ## everything a change must pass
	$(BIN)/python -m pytest -n 2 -m "not slow"

proof: setup       ## the long statistical proofs
	$(BIN)/python -m pytest -n 2 -m slow

bench: setup       ## figures: speed, memory, scaling; printed, never asserted
	$(BIN)/python -m tests.bench

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

setup:
	@.ci/setup

samples: setup     ## make the sample parts and their pictures again
	$(BIN)/python samples/make_samples.py

wheel: setup
	$(BIN)/python -m build --wheel

clean:
	rm -rf .venv build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
