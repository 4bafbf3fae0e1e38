# make demo: train, evaluate, film. make test: lint, types, tests. Both set themselves up in .venv first.
# make extremes: tests/extremes with all the steps of its long runs, which writes docs/extremes.md.
# make machines: this machine against itself as older ones, each of its features taken away alone.
PYTHON ?= python3
BIN := .venv/bin
OLD_GYMNASIUM := .venv/gymnasium-1.2.2

.PHONY: demo test benchmark benchmark-quick throughput speed costs extremes machines transfer readme clean
.DELETE_ON_ERROR:

demo: .venv/ready
	@$(BIN)/python scripts/demo.py

test: .venv/ready $(OLD_GYMNASIUM)/ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	EXPECTED_GYMNASIUM=1.2.2 PYTHONPATH=$(OLD_GYMNASIUM) $(BIN)/python -m pytest -q tests/test_env.py tests/test_tools.py tests/test_vector_env.py
	EXPECTED_GYMNASIUM=1.4.0 $(BIN)/python -m pytest -q

# Speed against accuracy: the full sweep writes docs/accuracy.md, the quick one (2 minutes) only its run folder.
benchmark: .venv/ready
	@$(BIN)/python scripts/benchmark.py --out docs

benchmark-quick: .venv/ready
	@$(BIN)/python scripts/benchmark.py --quick --no-progress

throughput: .venv/ready
	@$(BIN)/python scripts/throughput.py

speed: .venv/ready
	@$(BIN)/python scripts/speed.py

costs: .venv/ready
	@$(BIN)/python scripts/costs.py

extremes: .venv/ready
	@JACKBOX_EXTREMES=full $(BIN)/python -m pytest -q tests/extremes

machines: .venv/ready
	@JACKBOX_MACHINES=all $(BIN)/python -m pytest -q tests/test_portability.py

transfer: .venv/ready
	@$(BIN)/python scripts/transfer.py --seeds 5 --total-steps 1000000 500000 --out docs

readme: .venv/ready
	@$(BIN)/python scripts/readme.py

.venv/ready: pyproject.toml constraints.txt
	@start=$$(date +%s); set -e; \
	echo "Setting up .venv"; \
	$(PYTHON) -m venv .venv; \
	PIP_CONSTRAINT=constraints.txt $(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'; \
	echo "Set-up took $$(( $$(date +%s) - start )) s"
	@touch $@

# The same tests under the oldest Gymnasium that CI covers, laid over the environment without its extras.
$(OLD_GYMNASIUM)/ready: .venv/ready
	@rm -rf $(OLD_GYMNASIUM)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --target $(OLD_GYMNASIUM) gymnasium==1.2.2
	@touch $@

clean:
	rm -rf .venv .mypy_cache .ruff_cache .pytest_cache
