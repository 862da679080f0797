# `make demo` and `make test` set everything up in .venv and run; both can be repeated.
PYTHON ?= python3
VENV := .venv
# A requirements file that pins torch; GPU users give their own.
TORCH ?= envs/torch.txt
PIP_OPTIONS ?=
# Three processes, since many tests wait for Snakemake, Slurm or a browser; a module's tests stay
# together, since some build on one another. The modules come in the order of tests/conftest.py;
# left to itself, xdist takes those of few tests last, the long ones.
# A test that hangs for a quarter of an hour fails by its name instead of ending all.
PYTEST_OPTIONS ?= -n 3 --dist loadfile --no-loadscope-reorder --max-worker-restart=1 \
	-o faulthandler_timeout=900 -o faulthandler_exit_on_timeout=true

REQUIREMENTS := $(TORCH) envs/requirements.txt envs/constraints.txt

.PHONY: install demo test check mutants lint format docs container clean

install: $(VENV)/.installed

$(VENV)/.installed: $(REQUIREMENTS) envs/install_system_packages.sh envs/cherrypicker
	sh envs/install_system_packages.sh
	test -x $(VENV)/bin/python || $(PYTHON) -m venv $(VENV)
	$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check $(PIP_OPTIONS) \
		-r $(TORCH) -r envs/requirements.txt -c envs/constraints.txt
	$(VENV)/bin/python -c "import cv2, open3d, pycolmap, torch, torch_geometric"
	install -m 755 envs/cherrypicker $(VENV)/bin/cherrypicker
	touch $@

demo: install
	$(VENV)/bin/snakemake

test: install
	$(VENV)/bin/python -m pytest -m "not slow and not demo and not fuzz" $(PYTEST_OPTIONS)

# The demo's results against its ground truth, after `make demo`.
check: install
	$(VENV)/bin/python -m pytest -m demo

# Whether the tests notice spoilt lines: before a release; MUTANTS="--sample 3" for some.
mutants: install
	$(VENV)/bin/python scripts/lab/mutate.py $(MUTANTS)

lint: install
	$(VENV)/bin/ruff check
	$(VENV)/bin/ruff format --check
	$(VENV)/bin/mypy
	$(VENV)/bin/snakefmt --check Snakefile workflow
	$(VENV)/bin/snakemake --lint

format: install
	$(VENV)/bin/ruff format
	$(VENV)/bin/snakefmt Snakefile workflow

# The site of the documentation, in site/; a broken link fails.
docs: install
	$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check $(PIP_OPTIONS) \
		-r envs/requirements-docs.txt -c envs/constraints.txt
	$(VENV)/bin/mkdocs build --strict --quiet

# The image, built on a bare Debian and tried, as root with Debian's podman, runc and debootstrap.
container:
	envs/try_container.sh

clean:
	rm -rf results/* logs benchmarks .snakemake
