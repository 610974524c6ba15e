# Two commands need nothing but Python >= 3.11 and make: `make demo` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
RUN := runs/demo-$(shell date +%Y%m%d-%H%M%S)
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet
# Hundreds of processes import the same modules: what Python has compiled of them is kept also where the environment says otherwise.
unexport PYTHONDONTWRITEBYTECODE
# A process each core, which computes with one thread: two that share both cores wait for each other. Each begins with half
# of the tests in their order, so that what a file's tests share is made once.
PYTEST := NPROC=1 $(BIN)/python -m pytest -n 2 --dist worksteal
# Without XLA's newer emitters and without optimisation programs compile in a third of the time; as users have them they run faster.
QUICK := XLA_FLAGS="--xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=0"
GYMNAX_VENV := .venv-gymnax
LEROBOT_VENV := .venv-lerobot
# LeRobot needs Python 3.12. What stands in the place of a version that is installed may be a script that finds none.
IS_PYTHON_3_12 = $(shell $(1) -c 'import sys; sys.exit(sys.version_info[:2] != (3, 12))' 2>/dev/null && echo $(1))
LEROBOT_PYTHON ?= $(firstword $(foreach one,python3.12 $(wildcard $(HOME)/.pyenv/versions/3.12*/bin/python) $(PYTHON),$(call IS_PYTHON_3_12,$(one))))

.PHONY: demo check test lint types quick unit tiers slow kernels planted-faults bench bench-page foreign fuzz trust policies tables pictures docs docs-blocks three gymnax lerobot lerobot-python dist clean

demo: $(VENV)/installed
	@$(BIN)/reachlab train --out $(RUN)
	@$(BIN)/reachlab eval $(RUN) --agent trained ik random zero
	@echo "Curve: $(RUN)/curve.png   Report: $(RUN)/report.json   Shorter from here: source $(VENV)/bin/activate"

# Everything that a change should pass; `make check`, what answers soon: without the tests that take long.
test: lint types unit

check: $(VENV)/installed-dev
	@$(MAKE) --no-print-directory --jobs 3 --output-sync lint types quick

quick: $(VENV)/installed-dev
	$(QUICK) $(PYTEST) -m "not slow and not long"

# Which tests take long, measured anew; again until it stays as it is, since what is left out has prepared something for others.
tiers: $(VENV)/installed-dev
	: > tests/long_tests.txt
	$(QUICK) $(PYTEST) -m "not slow" --note-long
	$(QUICK) $(PYTEST) -m "not slow and not long" --note-long

lint: $(VENV)/installed-dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .

types: $(VENV)/installed-dev
	$(BIN)/pyright

unit: $(VENV)/installed-dev
	$(QUICK) $(PYTEST) -m "not slow"

# The tests that `make test` leaves out since each takes long: marked `slow`. Many wait for processes, a browser or the clock, so
# three processes share two cores. Programs of the tests that look at last bits or at
# compiled programs, marked `compiled`, are compiled as users' are.
slow: $(VENV)/installed-dev
	$(QUICK) $(PYTEST) -n 3 -m "slow and not compiled"
	$(PYTEST) -m compiled $(shell grep -l mark.compiled tests/test_*.py)

# What is derived of arms and compared, with the kernels of other CPUs: two of OpenBLAS's, and XLA's without AVX-512.
# SkylakeX's need a CPU that has AVX-512 (elsewhere they die of an illegal instruction), Sandybridge's do not.
CORES := Haswell $(if $(shell grep -m1 -w avx512f /proc/cpuinfo 2>/dev/null),SkylakeX,Sandybridge)
DERIVED := tests/test_kernels.py tests/test_shipped.py tests/test_workspace.py tests/test_capsules.py
kernels: $(VENV)/installed-dev
	for core in $(CORES); do \
		XDG_CACHE_HOME=$(CURDIR)/build/cache-$$core OPENBLAS_CORETYPE=$$core \
		XLA_FLAGS="--xla_cpu_max_isa=AVX2 --xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=0" \
		$(PYTEST) -m "not slow" $(DERIVED) || exit 1; done

foreign: $(VENV)/installed-dev
	PYTHONPATH=tests $(BIN)/python -m foreign_arms

# Twenty faults put in by hand: which of them make check catches, which only make test; half an hour.
planted-faults: $(VENV)/installed-dev
	$(BIN)/python tests/planted_faults.py

fuzz: $(VENV)/installed-dev
	$(BIN)/python tests/fuzz_commands.py 500

trust: $(VENV)/installed-dev
	PYTHONPATH=tests $(BIN)/python -m faults $(NAMES)

# All that come with reachlab, or some: make policies NAMES='panda/precise ur5e/track'. REPLACE=--replace keeps the new ones.
policies: $(VENV)/installed-dev
	TF_CPP_MIN_LOG_LEVEL=3 PYTHONPATH=tests $(BIN)/python -m shipped_policies $(NAMES) $(REPLACE)

# The tables of docs/tasks.md and docs/commands.md, from the code.
tables: $(VENV)/installed-dev
	PYTHONPATH=docs $(BIN)/python -m builder

# Pictures of the docs, all or some: make pictures NAMES='arms video plots sweep'.
pictures: $(VENV)/installed-dev
	PYTHONPATH=docs $(BIN)/python -m builder.pictures $(NAMES)

# The site, in build/site; any warning ends the build.
docs: $(VENV)/installed-dev
	rm -rf build/site
	$(BIN)/sphinx-build -q -E -W --keep-going docs build/site
	PYTHONPATH=tests $(BIN)/python -m browser.site build/site

# Runs the commands of README and docs, shortened.
docs-blocks: $(VENV)/installed-dev
	$(QUICK) PYTHONPATH=tests $(BIN)/python -m blocks

# In an environment of its own: gymnax needs an older gymnasium than the other tests.
gymnax: $(GYMNAX_VENV)/installed
	$(GYMNAX_VENV)/bin/python -m pytest tests/gymnax

# In an environment of its own: LeRobot needs Python 3.12, an older NumPy, and torch, which is large.
lerobot: $(LEROBOT_VENV)/installed
	$(QUICK) $(LEROBOT_VENV)/bin/python -m pytest tests/lerobot

lerobot-python:
	@test -n "$(LEROBOT_PYTHON)" || { echo "make lerobot needs Python 3.12, and finds none: name it, make lerobot LEROBOT_PYTHON=/path/to/python3.12."; exit 1; }

dist: $(VENV)/installed-dev
	$(BIN)/python tests/distribution.py

bench: $(VENV)/installed
	for suite in start speed kinematics learning; do $(BIN)/reachlab bench --suite $$suite; done

bench-page: $(VENV)/installed-dev
	TF_CPP_MIN_LOG_LEVEL=3 PYTHONPATH=tests $(BIN)/python -m browser.live $(RUNS)

# What of other projects is in the page: it is part of the repository, and made anew only for other versions.
BROWSER := src/reachlab/watch/page
PACK := import sys, zlib; sys.stdout.buffer.write(zlib.compress(sys.stdin.buffer.read(), 9))
three:
	rm -rf build/three && mkdir -p build/three && cp $(BROWSER)/three.entry.js build/three/
	cd build/three && npm install --silent --no-save three@0.187.0 meshoptimizer@1.3.0 esbuild@0.28.2 @mujoco/mujoco@3.14.0
	cd build/three && npx esbuild three.entry.js --bundle --minify --format=iife --global-name=THREE \
		--legal-comments=none --log-level=warning --outfile=three.min.js
	cp build/three/three.min.js $(BROWSER)/three.min.js
	cp build/three/node_modules/three/LICENSE $(BROWSER)/three.LICENSE
	cp build/three/node_modules/meshoptimizer/LICENSE.md $(BROWSER)/meshoptimizer.LICENSE
	cp $(VENV)/lib/python*/site-packages/mujoco-*.dist-info/licenses/LICENSE $(BROWSER)/mujoco.LICENSE
	for part in wasm js; do $(PYTHON) -c "$(PACK)" < build/three/node_modules/@mujoco/mujoco/mujoco.$$part \
		> $(BROWSER)/mujoco.$$part.zlib || exit 1; done

$(VENV)/bin/python $(GYMNAX_VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "reachlab needs Python 3.11 or newer; this is " + sys.version.split()[0] + ". Name another: make PYTHON=python3.12")'
	$(PYTHON) -m venv $(@:/bin/python=)

$(VENV)/installed: $(VENV)/bin/python pyproject.toml constraints.txt
	$(PIP) install --constraint constraints.txt --editable .
	@touch $@

$(VENV)/installed-dev: $(VENV)/bin/python pyproject.toml constraints.txt
	$(PIP) install --constraint constraints.txt --editable '.[dev]'
	@touch $@ $(VENV)/installed

$(GYMNAX_VENV)/installed: $(GYMNAX_VENV)/bin/python pyproject.toml constraints.txt tests/gymnax/constraints.txt
	grep -v '^gymnasium==' constraints.txt | cat - tests/gymnax/constraints.txt > $(GYMNAX_VENV)/constraints.txt
	$(GYMNAX_VENV)/bin/python -m pip --disable-pip-version-check --quiet install \
		--constraint $(GYMNAX_VENV)/constraints.txt --editable '.[gymnax]' rejax pytest pytest-timeout
	@touch $@

$(LEROBOT_VENV)/bin/python: | lerobot-python
	$(LEROBOT_PYTHON) -m venv $(LEROBOT_VENV)

$(LEROBOT_VENV)/installed: $(LEROBOT_VENV)/bin/python pyproject.toml constraints.txt tests/lerobot/constraints.txt lerobot_policy_reachlab/pyproject.toml
	grep -vE '^(fsspec|numpy|packaging|pillow|setuptools|torch|wandb)==' constraints.txt | cat - tests/lerobot/constraints.txt > $(LEROBOT_VENV)/constraints.txt
	$(LEROBOT_VENV)/bin/python -m pip --disable-pip-version-check --quiet install --constraint $(LEROBOT_VENV)/constraints.txt \
		--editable '.[deploy,lerobot]' --editable ./lerobot_policy_reachlab 'lerobot[dataset,evaluation,feetech,training]' pytest pytest-timeout
	@touch $@

clean:
	rm -rf build/site $(VENV) $(GYMNAX_VENV) $(LEROBOT_VENV) dist .pytest_cache .ruff_cache
