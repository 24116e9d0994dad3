# Everything this project can do, from a fresh clone: `make demo`, `make test`. `make help` lists the rest.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
EXTRAS ?= test
DEMO := demo-forest
NAIP ?= $(URBANFOREST_REAL_DATA)/naip_california
TRAIN = $(BIN)/urbanforest train-coverage "$(NAIP)" --hold-out 'eureka*' --hold-out 'bishop*'

.DEFAULT_GOAL := help
.PHONY: help install install-train demo test test-all readers lint format bench check-growth train-coverage train-coverage-small \
	train-parameters figures sample clean

help: ## list these targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## (.*)/  make \1\t\2/' | expand -t 18

$(VENV)/.installed: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "Python 3.11 or newer is needed: make PYTHON=/path/to/python3.11 $(MAKECMDGOALS)"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[$(EXTRAS)]'
	@touch $@

$(VENV)/.installed-train: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[$(EXTRAS),train]'
	@touch $@

install: $(VENV)/.installed ## make .venv and install the program into it

install-train: $(VENV)/.installed-train ## add what training needs: torch and its company

demo: install ## populate the sample city and show where to look
	$(BIN)/urbanforest populate data_samples/sample_city.gpkg --image data_samples/sample_city.tif -o $(DEMO)
	$(BIN)/urbanforest evaluate $(DEMO) --coverage $(DEMO)/coverage.tif --image data_samples/sample_city.tif \
		--sheet $(DEMO)/sheet.png
	@echo
	@echo "Look at:  $(DEMO)/view.png      the planted city from above"
	@echo "          $(DEMO)/map.png       its map"
	@echo "          $(DEMO)/sheet.png     an aerial picture, the trees found in it, and those planted"
	@echo "          $(DEMO)/forest.glb    all of it in 3D, for Blender or a browser"
	@echo "          $(DEMO)/report.html   counts, warnings, typical lots"
	@echo "          $(DEMO)/register.gpkg every plant, styled, for QGIS"
	@echo "Your own: $(BIN)/urbanforest populate CITY.gpkg"

test: install-train ## run the tests (without the slow ones, and those that need other programs)
	$(BIN)/python -m pytest -q -m "not slow and not readers"

test-all: install-train ## run all tests, the slow ones too
	$(BIN)/python -m pytest -q

readers: install ## open the outputs in three.js, CesiumJS, QGIS and others, which it installs where it may
	@if command -v npm >/dev/null; then npm ci --ignore-scripts --no-audit --no-fund --prefix tests/readers/node; \
		else echo "Without node and npm, nothing is opened in a browser or by Khronos' validator: install them."; fi
	@for need in chromium:chromium python3-qgis:qgis.core python3-gdal:osgeo_utils.samples.validate_gpkg; do \
		package=$${need%%:*}; what=$${need#*:}; \
		command -v $$what >/dev/null || /usr/bin/python3 -c "import $$what" 2>/dev/null || missing="$$missing $$package"; \
	done; \
	if [ -n "$$missing" ]; then \
		if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
			{ apt-get update -q && apt-get install -y -q --no-install-recommends $$missing; } || echo "Not installed:$$missing"; \
		else echo "Not there, and what needs it is skipped:$$missing"; fi; \
	fi
	$(BIN)/python -m pytest -q -rs -m readers tests/readers

lint: install-train ## check format, style and types
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy urbanforest_cli

format: install ## put the code into format
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: install-train ## measure speed as ratios in one run
	$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[test,train,bench]'
	$(BIN)/python -m benchmarks

check-growth: install ## hold open-grown plants of every species against measured ones
	$(BIN)/python -m benchmarks.growth_check

train-coverage: install-train ## train the coverage model that comes with the program again (about half an hour)
	@test -d "$(NAIP)/images" || { echo "NAIP must name the folder of images/ and trees/: see docs/models/coverage.md"; exit 1; }
	$(TRAIN) -o urbanforest_cli/models/coverage.onnx --overwrite --filters 24 --epochs 40 --patience 0 --threads 1 \
		--work training/coverage

train-coverage-small: install-train ## train a smaller one in about eight minutes and tell how good it is
	@test -d "$(NAIP)/images" || { echo "NAIP must name the folder of images/ and trees/: see docs/models/coverage.md"; exit 1; }
	$(TRAIN) -o training/small.onnx --overwrite --threads 1 --work training/small
	$(BIN)/urbanforest evaluate-coverage "$(NAIP)" -m training/small.onnx --group 'eureka*' --group 'bishop*'

train-parameters: install-train ## train the parameter model that comes with the program again (within half an hour)
	$(BIN)/urbanforest train-regression -o urbanforest_cli/models/parameters.onnx --overwrite --pairs 100000 --epochs 10 \
		--threads 1 --work training/parameters

figures: install ## render the paper's placement figures
	$(BIN)/urbanforest figures -o figures

sample: install ## make the sample city again
	SOURCE_DATE_EPOCH=1735689600 $(BIN)/urbanforest synth --lots 350 --seed 63 -o data_samples/sample_city.gpkg --overwrite \
		--image data_samples/sample_city.tif

clean: ## remove what was made
	rm -rf $(VENV) $(DEMO) figures training build dist .pytest_cache .mypy_cache .ruff_cache
