# One entry for everything. Each target brings what it needs up to date first; what is up to date is left alone.
.DEFAULT_GOAL := help
SHELL := /bin/bash
ENV := source tools/env.sh &&
# Tests talk only to this machine, on a domain of their own.
# One BLAS thread a test process: there are as many processes as cores.
TEST_ENV := OPENBLAS_NUM_THREADS=1 ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST ROS_DOMAIN_ID=$${STRESSBOT_TEST_DOMAIN_ID:-$$((RANDOM % 100 + 1))}

.PHONY: help build demo test oldest lint docs gallery notebook coverage sbom bench bench-extra faults soak orders mutants fuzz clean

help:  ## print this list
	@sed -n 's/^\([a-z-]*\):[^#]*## \(.*\)/make \1\t\2/p' Makefile | expand -t 18

build:  ## set up .venv, build the ROS 2 workspace, write .venv/bin/stressbot
	@tools/build.sh

demo: build  ## run the main job: six robots, three nodes, volts only (ARGS="..." is passed on)
	@.venv/bin/stressbot demo $(ARGS)

test: build lint  ## run all tests and checks (ARGS="-k name" is passed on to pytest)
	@$(ENV) export $(TEST_ENV); \
		python -m pytest -n 2 --max-worker-restart 0 --dist loadgroup --durations=15 -m "not timing" $(ARGS); most=$$?; \
		python -m pytest -m timing $(ARGS); timing=$$?; \
		case $$most-$$timing in 0-0 | 0-5 | 5-0) ;; *) exit 1 ;; esac # 5: ARGS chooses none of them

lint: build  ## check the style, the direction of imports and the types
	@$(ENV) ruff check --quiet --output-format concise && lint-imports --no-cache --no-logo && basedpyright --warnings

docs: build  ## build the documentation site into results/site (ARGS="--site-dir elsewhere" is passed on)
	@$(ENV) NO_MKDOCS_2_WARNING=1 python -m mkdocs build --strict $(ARGS)

gallery: build  ## plan and draw the scenarios of the gallery (ARGS="02-exchange" draws one)
	@$(ENV) python tools/gallery.py $(ARGS)

notebook: build  ## execute the notebooks of examples/ and store what they show
	@$(ENV) python tools/notebooks.py $(ARGS)

oldest:  ## run the packages' tests with the oldest libraries that we support, on Python 3.12 (ARGS is passed on to pytest)
	@tools/oldest.sh $(ARGS)

coverage: build  ## say which lines the tests run, node processes too; a report in results/coverage (ARGS is passed on to pytest)
	@$(ENV) export $(TEST_ENV) COVERAGE_FILE=$(CURDIR)/results/coverage/data; rm -rf results/coverage; mkdir -p results/coverage; \
		python -m coverage run -m pytest -q -n 2 --dist loadgroup -m "not timing" $(ARGS); tests=$$?; \
		python -m coverage combine -q && python -m coverage html -q -d results/coverage/html && \
		python -m coverage report | tail -n 1 && exit $$tests

sbom: build  ## list all components with their licences in results/sbom.json (CycloneDX)
	@tools/sbom.sh $(ARGS)

bench-extra: build  ## install what the benchmarks put beside our planners: CasADi with IPOPT, OMPL
	@$(ENV) python -m pip install -q --no-deps --require-hashes -r requirements/comparison.txt

bench: build  ## run the benchmarks (ARGS="..." is passed on)
	@$(ENV) python benchmarks/run.py $(ARGS)

faults: build  ## kill, freeze and confuse nodes while a sequence runs (ARGS="--repeats 20" is passed on)
	@$(ENV) PYTHONPATH=benchmarks:$$PYTHONPATH python -m faults $(ARGS)

soak: build  ## random work and faults, then memory, threads, files and volts in one table (ARGS="--minutes 120" is passed on)
	@$(ENV) PYTHONPATH=benchmarks:$$PYTHONPATH python -m faults.soak $(ARGS)

orders: build  ## let requests, losses and ends of a run come in every order, to the real session and gate (some minutes)
	@$(ENV) python -m pytest -q -s -n 2 ros2_ws/src/stressbot_driver/test/interleavings_in_full.py $(ARGS)

mutants: build  ## change what the last gate is made of, and let its tests find it (hours; ARGS="session" does a part)
	@$(ENV) tools/mutants.sh $(ARGS)

fuzz: build  ## throw hostile input at every interface (ARGS="--inputs 10000 motion_plan" is passed on)
	@$(ENV) python -m pip install -qq --no-input --disable-pip-version-check -r requirements/fuzz.txt && \
		OPENBLAS_NUM_THREADS=1 python -m fuzzing $(ARGS)

clean:  ## remove what make build has made
	@rm -rf .venv .stamps ros2_ws/build ros2_ws/install ros2_ws/log
