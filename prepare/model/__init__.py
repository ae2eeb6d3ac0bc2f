"""The shipped assets of the ring toss, modelled by code: `python vrgs.py build`."""
