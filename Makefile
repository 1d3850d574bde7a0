# Every verb works in a fresh clone. It needs Python 3.10 or newer, and installs into .venv only, or `make VENV=FOLDER`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Python compiles what is imported; to compile every module at once takes a minute.
unexport PYTHONDONTWRITEBYTECODE
INSTALL := $(BIN)/python -m pip install --quiet --no-compile --constraint constraints.txt --editable
ARGS =

export PIP_DISABLE_PIP_VERSION_CHECK = 1

.DEFAULT_GOAL := help
.NOTPARALLEL:
.PHONY: help demo video test commands test-all damage oldest matrix lint typecheck format bench train train-all pages verify examples docs package clean

help: ## list the verbs
	@echo 'make COMMAND [ARGS="more options"] [PYTHON=python3.12]'
	@sed -n 's/^\([a-z-]*\):.*## /  \1            /p' $(MAKEFILE_LIST) | sed 's/^\(.\{13\}\) */\1/'

demo: $(VENV)/demo.stamp ## recompute the paper, run every preset and a storm in space, record videos; in runs/demo
	$(BIN)/python -m research paper --out runs/demo/paper
	$(BIN)/python evaluate.py --suite presets --policy nmpc helm --out runs/demo/scenarios $(ARGS)
	$(BIN)/python evaluate.py --policy nmpc helm --scenario cruise-storm --jobs 1 --out runs/demo/storm $(ARGS)
	$(BIN)/python -m baselines video --policy backstepping nmpc helm --scenario cruise-storm --seed 15 \
	  --size 720x400 --speed 6 --fps 10 --out runs/demo/storm/video.webp
	$(BIN)/python evaluate.py --policy nmpc helm-3d --scenario space-storm --jobs 1 --out runs/demo/space $(ARGS)
	$(BIN)/python -m baselines video --policy nmpc helm-3d --scenario space-storm --seed 13 \
	  --size 560x400 --speed 6 --fps 8 --out runs/demo/space/video.webp
	@echo 'Open in a browser: the tables, runs/demo/*/report.html, and the videos, runs/demo/s*/video.webp'

# Of the twenty storms of an evaluation, the one whose errors are the most usual; in the plane and in space.
video: $(VENV)/demo.stamp ## record expert, EKF + MPC and agent in two usual storms as videos, for the README
	$(BIN)/python -m baselines video --policy backstepping nmpc helm --scenario cruise-storm --seed 15 \
	  --size 820x470 --speed 6 --fps 10 --out docs/images/storm.webp $(ARGS)
	$(BIN)/python -m baselines video --policy backstepping nmpc helm-3d --scenario space-storm --seed 13 \
	  --size 700x420 --speed 6 --fps 8 --out docs/images/space-storm.webp $(ARGS)

PYTEST = $(BIN)/python -m pytest -n 2 --dist worksteal

test: lint typecheck ## lint, typecheck and run the tests, without the slow ones
	$(PYTEST) -m "not slow" --durations 10 $(ARGS)

commands: $(VENV)/dev.stamp ## run the verbs and the lines of the pages, in a quick form
	$(PYTEST) -m "slow and not long" --durations 10 tests/test_commands.py

# The longest tests come first, so that no worker waits for the other one at the end.
test-all: test ## the tests, the slow ones too, and those of equations once more without a compiler
	$(PYTEST) --dist load --maxschedchunk 1 -m slow --durations 10 tests/test_commands.py tests
	AUV_GYM_NATIVE=0 $(PYTEST) -m "not slow" -k "$(UNCOMPILED)" $(EQUATIONS)

# The tests of equations run once more as on a machine without a compiler.
EQUATIONS = $(foreach name,agent codegen contract controllers disturbances effects elementary env evaluation kernels planner vector_env, \
  $(wildcard tests/*/test_$(name).py))
UNCOMPILED = not (16384 or torch or report_is_one_page or interrupted or number_of_jobs or as_a_process)

# Exit status 1 if a damaged file is not refused in one line, or a result differs after a kill.
damage: $(VENV)/dev.stamp ## half an hour: damaged files, and kills
	$(BIN)/python tests/mutated_files.py --count 300
	$(BIN)/python tests/kills.py

# In an environment of its own; without torch, whose old versions are gigabytes.
oldest: ## the tests of auv_gym with the oldest versions of its dependencies that are allowed
	$(PYTHON) -m venv --clear build/oldest
	build/oldest/bin/python -m pip install --quiet uv
	build/oldest/bin/uv pip install --quiet --python build/oldest --resolution lowest-direct --editable '.[eval]' --group platforms
	build/oldest/bin/python -m pytest -q tests/auv_gym $(ARGS)

VERSIONS = 3.10 3.11 3.12 3.13 3.14
matrix: ## the same with the newest ones, for each Python, found or downloaded by uv: VERSIONS="3.10 3.14"
	$(PYTHON) -m venv --clear build/uv
	build/uv/bin/python -m pip install --quiet uv
	@for version in $(VERSIONS); do \
	  echo "Python $$version"; \
	  build/uv/bin/uv venv --quiet --clear --python $$version build/matrix && \
	  build/uv/bin/uv pip install --quiet --python build/matrix --editable '.[eval]' --group platforms && \
	  build/matrix/bin/python -m pytest -q tests/auv_gym $(ARGS) || failed="$$failed $$version"; \
	done; \
	test -z "$$failed" || { echo "error: the tests do not pass with Python$$failed" >&2; exit 1; }

lint: $(VENV)/dev.stamp ## check the style, the format and the set-up of the project
	$(BIN)/python -m ruff check
	$(BIN)/python -m ruff format --check
	$(BIN)/lint-imports --no-cache
	$(BIN)/python -m repo_review --show err

typecheck: $(VENV)/dev.stamp ## check the types
	$(BIN)/python -m mypy

format: $(VENV)/dev.stamp ## mend the style and the format
	$(BIN)/python -m ruff check --fix
	$(BIN)/python -m ruff format

bench: $(VENV)/dev.stamp ## measure the speed of environments and policies, for docs/speed.md: ARGS="--quick"
	$(BIN)/python -m research speed --again $(ARGS)

pages: $(VENV)/eval.stamp ## write the pages of results and their figures from what was measured
	$(BIN)/python -m research pages $(ARGS)

verify: $(VENV)/eval.stamp ## run all that is recorded again, an hour: does every number repeat? ARGS="--policy lqi"
	$(BIN)/python -m research suites verify $(ARGS)

train: $(VENV)/train.stamp ## train an agent, into runs/train: ARGS="--algo ppo --scenario slow"
	$(BIN)/python train.py $(ARGS)

train-all: $(VENV)/train.stamp ## train every agent that ships with the package, into runs/shipped; goes on if interrupted
	$(BIN)/python -m research train-all $(ARGS)

examples: $(VENV)/venv.stamp ## run other people's libraries, into build/examples: ARGS="--quick sb3 torchrl"
	$(BIN)/python -m examples $(ARGS)

docs: $(VENV)/train.stamp $(VENV)/render.stamp $(VENV)/docs.stamp ## build the documentation: build/docs/index.html
	$(BIN)/python -m sphinx --fail-on-warning --keep-going --quiet --doctree-dir build/doctrees docs build/docs $(ARGS)

package: $(VENV)/dev.stamp ## build wheel and sdist, compare, check and use them in an empty environment: build/package
	$(BIN)/python tests/package.py $(ARGS)

clean: ## remove what was built, the environment included; runs/ stays
	@if $(OWN_VENV); then rm -rf $(VENV); else echo '$(VENV) stays: make did not make it'; fi
	rm -rf build dist .coverage .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# An environment that someone else made is never changed: the mark is in those of this file, even if interrupted.
MADE = $(VENV)/made-by-make
OWN_VENV = test ! -e $(VENV) -o -e $(MADE) -o -e $(VENV)/venv.stamp

# A stamp is newer than what it was made from: nothing is installed twice.
$(VENV)/venv.stamp:
	@command -v $(PYTHON) >/dev/null || { echo 'error: $(PYTHON) is not found: make PYTHON=/path/to/python3' >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' || { \
	  echo 'error: $(PYTHON) is older than Python 3.10: make PYTHON=/path/to/python3.10-or-newer' >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { \
	  echo 'error: $(PYTHON) cannot make environments (on Debian and Ubuntu: apt install python3-venv)' >&2; exit 1; }
	@$(OWN_VENV) || { \
	  echo 'error: make did not make $(VENV), so it stays as it is: make VENV=another-folder' >&2; exit 1; }
	@mkdir -p $(VENV) && touch $(MADE)
	$(PYTHON) -m venv $(VENV)
	@touch $@

$(VENV)/%.stamp: $(VENV)/venv.stamp pyproject.toml constraints.txt
	@echo 'Installing auv_gym[$*] into $(VENV). The first time takes minutes.'
	$(INSTALL) '.[$*]'
	@touch $@
