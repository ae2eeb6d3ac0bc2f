# make play   set everything up and play the ring toss (without a display: record it)
# make test   set everything up and run the tests
# make soak   for the night: the long tests, then 30 simulated minutes of random handling (hours)
# make build  model the shipped assets anew, from code
# make lint   check style

VENV := .venv
PYTHON := $(VENV)/bin/python

.PHONY: play test soak build lint clean

play: $(VENV)/.ready
	@$(PYTHON) vrgs.py --scene ring_toss

test: $(VENV)/.ready-tests
	@$(PYTHON) -m pytest -n 2 --dist loadfile --max-worker-restart 0

soak: $(VENV)/.ready-tests
	@$(PYTHON) -m pytest -n 2 --dist loadfile --max-worker-restart 0 -m long
	@$(PYTHON) -m bench.soak --minutes 30

build: $(VENV)/.ready
	$(PYTHON) vrgs.py build

lint: $(VENV)/.ready-tests
	$(PYTHON) -m ruff check .
	$(PYTHON) -m ruff format --check .

# The stamp says: the virtual environment holds just what the pinned lists ask for.
$(VENV)/.ready: requirements.txt setup.sh
	@sh setup.sh $(VENV) requirements.txt
	@touch $@

$(VENV)/.ready-tests: requirements.txt requirements-dev.txt setup.sh
	@sh setup.sh $(VENV) requirements-dev.txt xvfb xdotool libgl1-mesa-dri ffmpeg
	@touch $(VENV)/.ready $@

clean:
	rm -rf $(VENV) .pytest_cache .ruff_cache
