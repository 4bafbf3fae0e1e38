# make demo: train, evaluate, film. make test: lint, types, tests. Both set themselves up in .venv first.
# make test-all: the slow tests too. The other targets write the reports in docs/.
# make machines: the bits of this machine against itself as older ones, newer Pythons on PATH, and an emulated ARM.
# make roundings: what uses PyTorch, BLAS or numpy's kernels, as these round on other processors.
# On Windows: make BIN=.venv/Scripts PYTHON=python ...
PYTHON ?= python3
# Else each process that a test starts compiles the modules of PyTorch and numba again: most of its time.
unexport PYTHONDONTWRITEBYTECODE
BIN := .venv/bin
OLD_GYMNASIUM := .venv/gymnasium-1.2.2
# Every text file is opened with its encoding; command_line.py opens only the null device.
ENCODINGS := $(BIN)/ruff check --preview --select PLW1514 --per-file-ignores jackbox_env/tools/command_line.py:PLW1514 \
	jackbox_env agents scripts
# One thread each: two workers on two cores would wait for each other's.
PYTEST := OMP_NUM_THREADS=1 $(BIN)/python -m pytest -q
WORKERS := -n 2 --dist loadfile --no-loadscope-reorder
SELECTED := -m "not slow"
# What calls Gymnasium.
UNDER_OLD_GYMNASIUM := --deselect tests/guarantees/test_bits.py::test_every_kind_of_environment_does_the_same_whatever_is_called \
	$(addprefix tests/,environment/test_env.py environment/test_starts_and_settings.py environment/test_tools.py \
	batches/test_vector_env.py guarantees/test_bits.py)
# Settings in which PyTorch, MKL, OpenBLAS and numpy 2.4 use code for other processors; + joins several.
OTHER_NUMPY := NPY_DISABLE_CPU_FEATURES=X86_V3,X86_V4,AVX512_ICL
ROUNDINGS := ATEN_CPU_CAPABILITY=default ATEN_CPU_CAPABILITY=avx2 MKL_CBWR=COMPATIBLE OPENBLAS_CORETYPE=Haswell \
	OPENBLAS_CORETYPE=Prescott $(OTHER_NUMPY)
SEVERAL_ROUNDINGS := ATEN_CPU_CAPABILITY=default+OPENBLAS_CORETYPE=Prescott+$(OTHER_NUMPY)
ROUNDED := $(addprefix tests/,agents batches commands environment measuring studies guarantees/test_derivatives.py \
	test_first_day.py test_lesson.py test_package.py)
# Those in which networks play and train, and derivatives.
ROUNDED_QUICKLY := $(addprefix tests/,$(addprefix agents/test_,cards.py landing.py network.py planner.py \
	saved_models.py training.py value.py zoo.py) batches/test_torch.py environment/test_ilqr.py \
	measuring/test_fitting.py agents/test_distil.py)

.PHONY: demo test test-all test-oldest accuracy accuracy-quick engines throughput speed fitting prove prove-quick reference soak extremes machines roundings roundings-quick kills interrupts mutants benchmark networks readme words docs recipes wheel dataset ranges clean
.DELETE_ON_ERROR:

demo: .venv/usable
	@$(BIN)/python -m jackbox_env check
	@$(BIN)/python scripts/demo.py

# The compiled code is made once, before the workers start (tests/conftest.py).
test: .venv/ready
	$(BIN)/ruff check .
	$(ENCODINGS)
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	EXPECTED_GYMNASIUM=1.4.0 $(PYTEST) $(WORKERS) $(SELECTED)

# Also kills, soaks, long runs and make wheel, all cases of the sweeps, and the environment under the oldest Gymnasium
# covered.
test-all: SELECTED := --whole
test-all: test-oldest test

test-oldest: .venv/ready $(OLD_GYMNASIUM)/ready
	EXPECTED_GYMNASIUM=1.2.2 PYTHONPATH=$(OLD_GYMNASIUM) $(PYTEST) $(UNDER_OLD_GYMNASIUM)

# Studies: --render writes a page from its stored results; an interrupted study prints how it continues.
# Speed against accuracy: the full sweep writes docs/accuracy.md, the quick one (about 2 minutes) only its run folder.
accuracy: .venv/ready
	@$(BIN)/python scripts/studies/accuracy/accuracy.py

accuracy-quick: .venv/ready
	@$(BIN)/python scripts/studies/accuracy/accuracy.py --quick --out None --no-progress

# Box2D v3, Rapier, matter.js and Drake on the proven motions, the part of docs/accuracy.md, a quarter of an hour. Those
# that are not installed stay as they are stored: pip install pyb2d3 drake; npm install --no-save, here,
# @dimforge/rapier2d-compat matter-js.
engines: .venv/ready
	@$(BIN)/python scripts/studies/accuracy/accuracy.py --parts search engines engine_costs

# Single environments only, a minute: the README's table, and the part of docs/speed.md.
throughput: .venv/ready
	@$(BIN)/python scripts/studies/speed/speed.py --parts alone

speed: .venv/ready
	@$(BIN)/python scripts/studies/speed/speed.py

# 1,500 fits of recordings, docs/fitting.md.
fitting: .venv/ready
	@OMP_NUM_THREADS=1 $(BIN)/python scripts/studies/fitting/fitting.py --workers 2

# Each step of many motions proven by interval arithmetic, the table of docs/trust.md, a minute or two; quick: in small,
# only printed.
prove: .venv/ready
	@OMP_NUM_THREADS=1 $(BIN)/python -m tests.proving $(PROVE)

prove-quick: .venv/ready
	@OMP_NUM_THREADS=1 $(BIN)/python -m tests.proving --quick

# The proven motions of docs/reference.md, a few seconds; the same bytes each time.
reference: .venv/ready
	@OMP_NUM_THREADS=1 $(BIN)/python -m tests.reference

# Random cases for hours, new ones in each round of about 40 minutes, until an invariant fails.
soak: .venv/ready
	@for round in $$(seq 12); do \
		HYPOTHESIS_PROFILE=hours $(PYTEST) --whole tests/invariants && \
		HYPOTHESIS_PROFILE=hours $(PYTEST) tests/guarantees/test_bits.py || exit 1; done

extremes: .venv/ready
	@$(BIN)/python -m tests.extremes

# ARM needs Debian's debootstrap and qemu-user-static, root and about 10 minutes; else it is skipped and named.
machines: .venv/ready
	@JACKBOX_MACHINES=all $(PYTEST) -rs tests/guarantees/test_other_machines.py

# About 3 minutes for each setting; quick: the tests of networks and derivatives under several settings at once, a minute.
roundings: .venv/ready
	@$(foreach setting,$(ROUNDINGS),echo "$(setting)" && $(subst +, ,$(setting)) \
		$(PYTEST) $(WORKERS) $(SELECTED) $(ROUNDED) &&) true

roundings-quick: ROUNDINGS := $(SEVERAL_ROUNDINGS)
roundings-quick: ROUNDED := $(ROUNDED_QUICKLY)
roundings-quick: roundings

# Trainings killed 200 times at random moments.
kills: .venv/ready
	@JACKBOX_KILLS=200 $(PYTEST) tests/guarantees/test_kills.py

# Steps and rollouts on two threads interrupted 100,000 times by each of two signals, and compiling 100 times; half an hour.
interrupts: .venv/ready
	@JACKBOX_INTERRUPTS=100000 $(PYTEST) tests/guarantees/test_interruptions.py -k random_moments

# Mutation testing: 60 small faults, one at a time, and the first test that fails of each; some hours.
mutants: .venv/ready
	@$(BIN)/python -m tests.mutants $(MUTANTS)

# Returns of every policy, and of algorithms, docs/benchmark.md: what is not stored is trained, up to 15 hours of one core.
benchmark: .venv/ready
	@OMP_NUM_THREADS=1 $(BIN)/python scripts/studies/benchmark/benchmark.py $(BENCHMARK)

# Train the networks of agents/trained again: 1.2 to 4 million decisions, about 40 to 180 s of one core each.
networks: .venv/ready
	@$(BIN)/python -m agents.training.networks

# The site in docs/_build/html; the notebooks run, about two minutes. A warning, and so a broken link, is an error.
docs: .venv/ready
	@SDL_VIDEODRIVER=dummy $(BIN)/python -m sphinx -q -W --keep-going docs docs/_build/html
	@echo "Open docs/_build/html/index.html"

# Each recipe of docs/recipes.md, shortened; those of other libraries in environments of their own in runs/recipes.
recipes: .venv/ready
	@$(BIN)/python scripts/recipes/run.py

# Two wheels in dist: one for any platform, and one for Linux with the exact model compiled. A slow test builds both, and
# tries the second.
wheel: .venv/ready
	@$(PYTEST) -rs -m slow tests/commands/test_wheel.py -k shipped

# The core of the tests under the oldest and the newest dependencies allowed, and whether the bits are the same; 6 minutes.
ranges: .venv/ready
	@$(BIN)/python scripts/ranges.py

# Minari datasets of random torques, PPO and the planner on each task, in runs/dataset; about 3 minutes.
dataset: .venv/ready
	@OMP_NUM_THREADS=1 $(BIN)/python scripts/dataset.py

# Words of README, changelog and pages, tables and code included.
words:
	@cat README.md CHANGELOG.md CONTRIBUTING.md docs/*.md docs/*/*.md | wc -w

readme: .venv/ready
	@$(BIN)/python scripts/studies/readme.py

# What the package's user installs; .venv/ready has that too, and what tests and reports need.
.venv/usable: EXTRA := all
.venv/ready: EXTRA := dev
# --no-compile: Python compiles a module when it is first imported, and most never are.
.venv/usable .venv/ready: pyproject.toml constraints.txt
	@start=$$(date +%s); set -e; \
	echo "Setting up .venv for $(EXTRA)"; \
	$(PYTHON) -m venv .venv; \
	PIP_CONSTRAINT=constraints.txt $(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check --editable '.[$(EXTRA)]'; \
	echo "Set-up took $$(( $$(date +%s) - start )) s"
	@touch .venv/usable $@

# The same tests under the oldest Gymnasium that CI covers, laid over the environment without its extras.
$(OLD_GYMNASIUM)/ready: .venv/ready
	@rm -rf $(OLD_GYMNASIUM)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --target $(OLD_GYMNASIUM) gymnasium==1.2.2
	@touch $@

clean:
	rm -rf .venv .mypy_cache .ruff_cache .pytest_cache
