# make play   set everything up and play the ring toss (without a display: record it)
# make test   set everything up and run the tests
# make soak   run the long tests, then 30 simulated minutes of random handling (hours)
# make build  rebuild the shipped assets from code
# make lint   check style
# make clean  remove the virtual environment and caches

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

# Stamps: newer than the pinned lists when the virtual environment holds what they ask for.
$(VENV)/.ready: requirements.txt setup.sh
	@sh setup.sh $(VENV) requirements.txt
	@touch $@

$(VENV)/.ready-tests: requirements.txt requirements-dev.txt setup.sh
	@sh setup.sh $(VENV) requirements-dev.txt xvfb xdotool libgl1-mesa-dri ffmpeg
	@touch $(VENV)/.ready $@

clean:
	rm -rf $(VENV) .pytest_cache .ruff_cache
