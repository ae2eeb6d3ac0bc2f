# make play   set everything up and play the ring toss (without a display: record it)
# make test   set everything up and run the tests
# make soak   run the long tests, then 30 simulated minutes of random handling (hours)
# make nightly  100,000 mutated files for the readers; kills, full disks, several programs; the other back end; 8 hours of
#             random play
# make studio run the tests of the tool that models the shipped assets (python -m studio)
# make binary make the program one executable file, dist/vrgs, and play with it in a bare chroot
# make lint   check style
# make clean  remove the virtual environment and caches

VENV := .venv
PYTHON := $(VENV)/bin/python

.PHONY: play test soak nightly studio binary lint clean

play: $(VENV)/.ready
	@$(PYTHON) vrgs.py --scene ring_toss

test: $(VENV)/.ready-tests
	@$(PYTHON) -m pytest -n 2 --dist loadfile --max-worker-restart 0

soak: $(VENV)/.ready-tests
	@$(PYTHON) -m pytest -n 2 --dist loadfile --max-worker-restart 0 -m long
	@$(PYTHON) -m tests.soak.soak --minutes 30

nightly: $(VENV)/.ready-tests $(VENV)/.ready-quadrants
	@$(PYTHON) -m tests.pins
	@$(PYTHON) -m tests.fuzz.run --cases 100000
	@$(PYTHON) -m tests.faults.run kill
	@$(PYTHON) -m tests.faults.run full
	@$(PYTHON) -m tests.faults.run together --count 100
	@VRGS_BACKEND=quadrants $(PYTHON) -m pytest -n 2 --dist loadfile tests/core tests/sim tests/render
	@VRGS_BACKEND=quadrants $(PYTHON) vrgs.py --scene ring_toss --headless --arch cpu --size 320x180
	@$(PYTHON) -m tests.soak.endurance --minutes 480

studio: $(VENV)/.ready-tests $(VENV)/.ready-studio
	@$(PYTHON) -m pytest -n 2 --dist loadfile --max-worker-restart 0 studio/tests tests/prepare/test_tetgen_mesher.py

binary: $(VENV)/.ready-binary
	@$(PYTHON) -m PyInstaller --noconfirm --log-level ERROR installer/vrgs.spec
	@sh installer/play_in_chroot.sh dist/vrgs || [ $$? = 77 ]

lint: $(VENV)/.ready-tests
	$(PYTHON) -m ruff check .
	$(PYTHON) -m ruff format --check .

# Stamps: newer than the pinned lists when the virtual environment holds what they ask for.
$(VENV)/.ready: requirements.txt setup.sh
	@sh setup.sh $(VENV) requirements.txt
	@touch $@

$(VENV)/.ready-studio: $(VENV)/.ready studio/requirements.txt
	@sh setup.sh $(VENV) studio/requirements.txt libusb-1.0-0
	@touch $@

$(VENV)/.ready-quadrants: $(VENV)/.ready requirements-quadrants.txt
	@sh setup.sh $(VENV) requirements-quadrants.txt
	@touch $@

$(VENV)/.ready-binary: requirements.txt requirements-binary.txt setup.sh
	@sh setup.sh $(VENV) requirements-binary.txt binutils libpython3-dev
	@touch $(VENV)/.ready $@

$(VENV)/.ready-tests: requirements.txt requirements-dev.txt setup.sh
	@sh setup.sh $(VENV) requirements-dev.txt xvfb xdotool libgl1-mesa-dri ffmpeg
	@touch $(VENV)/.ready $@

clean:
	rm -rf $(VENV) .pytest_cache .ruff_cache build dist
