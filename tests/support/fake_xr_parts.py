"""Parts of the OpenXR runtime that is made up: where head and hands are, what they do, and the swapchains."""

from __future__ import annotations

import ctypes
import types


class Input:
    """Poses and actions."""

    def locate_views(self, session, info):
        xr, flags = self._real, self._real.ViewStateFlags
        known = flags.NONE
        if "head" in self.valid:
            known |= flags.ORIENTATION_VALID_BIT if "orientation" in self.kinds else flags.NONE
            known |= flags.POSITION_VALID_BIT if "position" in self.kinds else flags.NONE
        views = []
        for _ in range(2):
            view = xr.View()
            view.fov = xr.Fovf(-0.7, 0.7, 0.7, -0.7)
            if "head" in self.valid:
                fill(view.pose, *self.head)
            else:
                fill(view.pose, (0.0,) * 4, (0.0,) * 3)
            views.append(view)
        return types.SimpleNamespace(view_state_flags=known), views

    def enumerate_reference_spaces(self, session):
        return [self._real.ReferenceSpaceType.LOCAL, self._real.ReferenceSpaceType.STAGE]

    def create_reference_space(self, session, info):
        return self._handle("Space")

    def create_action_set(self, instance, info):
        return self._handle("ActionSet")

    def create_action(self, set, info):
        handle = self._handle("Action")
        self._names[self._number(handle)] = info.action_name.decode()
        return handle

    def suggest_interaction_profile_bindings(self, instance, suggestion):
        pass

    def attach_session_action_sets(self, session, info):
        pass

    def create_action_space(self, session, info):
        handle = self._handle("Space")
        self._names[self._number(handle)] = self._hand(info.subaction_path)
        return handle

    def _hand(self, path: int) -> str:
        return next(side for side in ("left", "right") if self._names.get(f"/user/hand/{side}") == path)

    def sync_actions(self, session, info):
        if self.state != "FOCUSED":
            raise self._real.SessionNotFocused

    def _state(self, info, value, **more):
        return types.SimpleNamespace(current_state=value, changed_since_last_sync=True, is_active=True, **more)

    def get_action_state_float(self, session, info):
        hand, name = self._hand(info.subaction_path), self._names[self._number(info.action)]
        return self._state(info, self.squeeze[hand] if name == "grab" else 0.0)

    def get_action_state_vector2f(self, session, info):
        return self._state(info, types.SimpleNamespace(x=0.0, y=0.0))

    def get_action_state_boolean(self, session, info):
        hand, name = self._hand(info.subaction_path), self._names[self._number(info.action)]
        return self._state(info, (name, hand) in self.pressed)

    def locate_space(self, space, base, time):
        flags, hand = self._real.SpaceLocationFlags, self._names[self._number(space)]
        location = types.SimpleNamespace(pose=self._real.Posef(), location_flags=flags.NONE)
        if hand in self.valid:
            fill(location.pose, *self.hands.get(hand, ((0.0, 0.0, 0.0, 1.0), (0.2, 1.2, -0.3))))
            location.location_flags = flags.ORIENTATION_VALID_BIT | flags.POSITION_VALID_BIT
        return location

    def apply_haptic_feedback(self, session, info, vibration):
        if self.state != "FOCUSED":
            raise self._real.SessionNotFocused
        self.pulses.append((self._hand(info.subaction_path), vibration.amplitude))


class Swapchains:
    """Three images each; who draws must have acquired and waited."""

    def enumerate_swapchain_formats(self, session):
        return list(self.formats)

    def create_swapchain(self, session, info):
        if info.format not in self.formats:
            raise self._real.SwapchainFormatUnsupportedError
        handle = self._handle("Swapchain")
        images = [self._images(info.width, info.height, info.format) for _ in range(3)]
        self.chains[self._number(handle)] = {
            "size": (info.width, info.height), "format": info.format, "images": images, "held": [], "next": 0,
        }  # fmt: skip
        return handle

    def destroy_swapchain(self, chain):
        self._destroy(chain)

    def enumerate_swapchain_images(self, chain, kind):
        return [types.SimpleNamespace(image=image) for image in self.chains[self._number(chain)]["images"]]

    def acquire_swapchain_image(self, chain, info):
        c = self.chains[self._number(chain)]
        index, c["next"] = c["next"], (c["next"] + 1) % 3
        c["held"].append([index, "acquired"])
        return index

    def wait_swapchain_image(self, chain, info):
        c = self.chains[self._number(chain)]
        if not c["held"] or c["held"][0][1] != "acquired":
            raise self._real.CallOrderInvalidError
        c["held"][0][1] = "waited"

    def release_swapchain_image(self, chain, info):
        c = self.chains[self._number(chain)]
        if not c["held"] or c["held"][0][1] != "waited":
            raise self._real.CallOrderInvalidError
        c["last"] = c["held"].pop(0)[0]

    def _view(self, view) -> dict:
        """A view of the projection layer: its rectangle, and that of its depth with near and far."""
        seen = {"rectangle": self._rectangle(view.sub_image)}
        if view.next:
            kind = ctypes.POINTER(self._real.CompositionLayerDepthInfoKHR)
            info = ctypes.cast(ctypes.c_void_p(view.next), kind).contents
            assert info.type == self._real.StructureType.COMPOSITION_LAYER_DEPTH_INFO_KHR
            seen |= {"depth": self._rectangle(info.sub_image), "near": info.near_z, "far": info.far_z}
        return seen

    def _rectangle(self, image) -> tuple[int, ...]:
        chain = self.chains[self._number(image.swapchain)]
        (x, y), (width, height) = tuple(image.image_rect.offset), tuple(image.image_rect.extent)
        if x < 0 or y < 0 or x + width > chain["size"][0] or y + height > chain["size"][1] or chain["held"]:
            raise self._real.SwapchainRectInvalidError
        return x, y, width, height


def fill(pose, rotation, position) -> None:
    """An XrPosef of (x, y, z, w) and (x, y, z)."""
    for name, value in zip("xyzw", rotation, strict=True):
        setattr(pose.orientation, name, value)
    for name, value in zip("xyz", position, strict=True):
        setattr(pose.position, name, value)
