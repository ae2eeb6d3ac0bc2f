"""An OpenXR runtime: is there one, which extensions has it, is a headset connected. Knows nothing of worlds."""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
import time

from core.errors import BadInput
from display.xr import hand_tracking

INSTEAD = "leave out --xr to play in a window"
WISHED = [  # extensions that are used where they are
    "XR_KHR_convert_timespec_time",
    "XR_KHR_composition_layer_depth",
    hand_tracking.EXTENSION,
]
WAIT = 30.0  # [s] for a headset that the runtime says is not there yet


def import_xr():
    """The module xr, or BadInput that says what is missing."""
    os.environ.setdefault("XR_LOADER_DEBUG", "none")  # what it complains of, we say in one line
    try:
        import xr
    except ImportError as e:
        raise BadInput(f"--xr: {e.name} is not installed; run `make play` once, or {INSTEAD}") from e
    except OSError as e:  # the loader's library does not open here
        raise BadInput(f"--xr: the OpenXR loader does not start on this system ({e}); {INSTEAD}") from e
    return xr


class Runtime:
    """One instance and the headset's system. `views` are the recommended (width, height) [px] of the eyes.

    `graphics` names the extensions without which nothing can be drawn; `enabled` are these and those of WISHED that are
    there; `has_hands`: hands are tracked. Raises BadInput with one clear line.
    """

    def __init__(self, graphics: list[str], *, wait: float = WAIT):
        self.xr = xr = import_xr()
        self.instance = None
        try:
            there = {e.extension_name.decode() for e in xr.enumerate_instance_extension_properties()}
        except xr.exception.ResultException as e:
            raise no_runtime() from e
        if missing := [name for name in graphics if name not in there]:
            raise BadInput(f"--xr: this OpenXR runtime cannot take OpenGL pictures (no {missing[0]}); {INSTEAD}")
        self.enabled = [*graphics, *(name for name in WISHED if name in there)]
        try:
            self.instance = xr.create_instance(
                xr.InstanceCreateInfo(
                    enabled_extension_names=self.enabled,
                    application_info=xr.ApplicationInfo("VR-GS", 1, "VR-GS", 1, xr.Version(1, 0, 34)),
                )
            )
        except (xr.RuntimeUnavailableError, xr.InitializationFailedError, xr.RuntimeFailureError) as e:
            raise no_runtime() from e
        except xr.exception.ResultException as e:
            raise BadInput(f"--xr: the OpenXR runtime does not start ({type(e).__name__}); {INSTEAD}") from e
        self.name = "the runtime"
        try:
            properties = xr.get_instance_properties(self.instance)
            self.name = f"{properties.runtime_name.decode(errors='replace')} {xr.Version(properties.runtime_version)}"
            self.system = self._headset(wait)
            self.views, self.blend = self._views(), self._blend_mode()
            self.has_hands = self._has_hands()
        except xr.exception.ResultException as e:
            self.close()
            raise BadInput(f"--xr: {self.name} fails ({type(e).__name__}); start it anew, or {INSTEAD}") from e
        except BaseException:
            self.close()
            raise

    def _headset(self, wait: float):
        """The system of a headset; one that is not connected may still come."""
        xr, end, told = self.xr, time.monotonic() + wait, False
        while True:
            try:
                return xr.get_system(self.instance, xr.SystemGetInfo(form_factor=xr.FormFactor.HEAD_MOUNTED_DISPLAY))
            except xr.FormFactorUnsupportedError as e:
                raise BadInput(f"--xr: {self.name} drives no headset; {INSTEAD}") from e
            except xr.FormFactorUnavailableError as e:
                if time.monotonic() >= end:
                    raise BadInput(f"--xr: {self.name} finds no headset; connect it and put it on, or {INSTEAD}") from e
                if not told:
                    print(f"{self.name}: waiting {wait:.0f} s for a headset", file=sys.stderr, flush=True)
                    told = True
                time.sleep(0.5)

    def _has_hands(self) -> bool:
        asked = hand_tracking.EXTENSION in self.enabled
        return asked and hand_tracking.supported(self.xr, self.instance, self.system)

    def _views(self) -> list[tuple[int, int]]:
        xr = self.xr
        stereo = xr.ViewConfigurationType.PRIMARY_STEREO
        if stereo not in [
            xr.ViewConfigurationType(v) for v in xr.enumerate_view_configurations(self.instance, self.system)
        ]:
            raise BadInput(f"--xr: {self.name} shows no stereo pictures; {INSTEAD}")
        views = xr.enumerate_view_configuration_views(self.instance, self.system, stereo)
        return [(v.recommended_image_rect_width, v.recommended_image_rect_height) for v in views]

    def _blend_mode(self):
        """Opaque where the headset has it; see-through glasses have others."""
        xr = self.xr
        stereo = xr.ViewConfigurationType.PRIMARY_STEREO
        modes = [
            xr.EnvironmentBlendMode(m) for m in xr.enumerate_environment_blend_modes(self.instance, self.system, stereo)
        ]
        return xr.EnvironmentBlendMode.OPAQUE if xr.EnvironmentBlendMode.OPAQUE in modes else modes[0]

    def now(self) -> int | None:
        """The present as an XrTime [ns]; None where the runtime cannot tell (XR_KHR_convert_timespec_time)."""
        if "XR_KHR_convert_timespec_time" not in self.enabled:
            return None
        xr, answer = self.xr, self.xr.Time()
        address = xr.get_instance_proc_addr(self.instance, "xrConvertTimespecTimeToTimeKHR")
        convert = ctypes.cast(address, xr.PFN_xrConvertTimespecTimeToTimeKHR)
        present = xr.timespec(*divmod(time.clock_gettime_ns(time.CLOCK_MONOTONIC), 10**9))
        result = xr.check_result(convert(self.instance, ctypes.byref(present), ctypes.byref(answer)))
        if result.is_exception():
            raise result
        return answer.value

    def path(self, text: str):
        return self.xr.string_to_path(self.instance, text)

    def events(self):
        """What has happened since the last call, as XrEventData structures of their own type."""
        xr = self.xr
        kinds = {
            xr.StructureType.EVENT_DATA_SESSION_STATE_CHANGED.value: xr.EventDataSessionStateChanged,
            xr.StructureType.EVENT_DATA_INSTANCE_LOSS_PENDING.value: xr.EventDataInstanceLossPending,
            xr.StructureType.EVENT_DATA_REFERENCE_SPACE_CHANGE_PENDING.value: xr.EventDataReferenceSpaceChangePending,
        }
        while True:
            try:
                event = xr.poll_event(self.instance)
            except xr.EventUnavailable:
                return
            kind = kinds.get(event._type)  # one that this module does not know is no error
            if kind is not None:
                yield kind.from_buffer_copy(event)

    def close(self) -> None:
        """Let the runtime go. Further calls do nothing."""
        if self.instance is not None:
            instance, self.instance = self.instance, None
            with contextlib.suppress(self.xr.exception.ResultException):  # it may be gone already
                self.xr.destroy_instance(instance)


def no_runtime() -> BadInput:
    return BadInput(
        "--xr: no OpenXR runtime answers; start SteamVR, Quest Link, WiVRn or Monado and make it the active one, "
        f"or {INSTEAD}"
    )
