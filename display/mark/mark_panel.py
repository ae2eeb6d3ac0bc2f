"""The panel beside the picture that is marked: objects, tools, views, and what the keys do."""

from __future__ import annotations

WIDTH = 248.0  # in screen coordinates at a display scale of 1
LIST_ROWS = 6  # of objects, or of views, that are seen at once
TOOLS = {"inside": "Inside", "outside": "Outside", "boxes": "Box"}
HINTS = (
    "Left: inside; right, Shift: outside\n"
    "B: box   N: new   1-9: choose object\n"
    "Ctrl+Z, Ctrl+Y: undo, redo\n"
    "Del: delete the object\n"
)
PHOTOGRAPH_HINTS = (
    "Tab, Shift+Tab: next, previous\nWheel: nearer; middle: move; Home: all\n"
    "Colours are a first idea, of this photograph alone"
)
ORBIT_HINTS = "Space or middle drag: turn\nWheel: nearer   W A S D Q E: move\n+ -: grow, shrink   Tab: next view"


class MarkPanel:
    """Panel of a MarkWindow, at its left."""

    def __init__(self, window):
        self._window = window
        self._typed: str | None = None  # a name that is being written

    def draw(self, size: tuple[int, int], scale: float) -> None:
        """Draw it, (width, height) in screen coordinates, and do what is clicked."""
        from imgui_bundle import imgui

        flag = imgui.WindowFlags_
        imgui.set_next_window_pos((0, 0))
        imgui.set_next_window_size(size)
        flags = flag.no_title_bar | flag.no_resize | flag.no_move | flag.no_nav | flag.no_bring_to_front_on_focus
        imgui.begin("Marks", None, flags)
        self._objects(scale)
        imgui.separator()
        self._tools()
        imgui.separator()
        self._views(scale)
        imgui.separator()
        imgui.text_wrapped(self._window.line or "Draw a stroke inside of what shall be an object.")
        done = imgui.get_frame_height_with_spacing()
        hints = HINTS + (PHOTOGRAPH_HINTS if self._window.subject.free is None else ORBIT_HINTS)
        wide = imgui.get_content_region_avail().x
        high = imgui.calc_text_size(hints, False, wide).y
        imgui.set_cursor_pos_y(
            max(imgui.get_cursor_pos_y(), size[1] - done - high - 3 * imgui.get_style().item_spacing.y)
        )
        if imgui.button("Done (Enter)", (wide, 0.0)):
            self._window.finish()
        imgui.push_style_color(imgui.Col_.text, imgui.get_style().color_(imgui.Col_.text_disabled))
        imgui.text_wrapped(hints)
        imgui.pop_style_color()
        imgui.end()

    def _objects(self, scale: float) -> None:
        from imgui_bundle import imgui

        edit, subject = self._window.edit, self._window.subject
        rows = min(len(edit.state.objects), LIST_ROWS)
        imgui.text("Objects")
        imgui.begin_child("objects", (0.0, rows * imgui.get_frame_height_with_spacing()))
        for k, name in enumerate(edit.state.objects):
            imgui.color_button(f"##colour{k}", (*subject.colour(k), 1.0))
            imgui.same_line()
            if k == edit.current:
                self._name(name)
                continue
            views = len({m.view for m in edit.state.marks if m.object == name})
            if imgui.selectable(f"{k + 1}  {name}   {f'in {views}' if views else 'no marks'}##{k}", False)[0]:
                edit.choose(k)
        imgui.end_child()
        self._buttons(
            {"New": edit.new_object, "Delete": edit.delete, "Undo": self._window.undo, "Redo": self._window.redo}
        )

    def _name(self, name: str) -> None:
        """The name of the current object, which can be written anew."""
        from imgui_bundle import imgui

        imgui.set_next_item_width(-1.0)
        imgui.push_item_flag(imgui.ItemFlags_.no_tab_stop, True)  # Tab is for the next view
        current = name if self._typed is None else self._typed
        changed, text = imgui.input_text("##name", current, imgui.InputTextFlags_.auto_select_all)
        if changed:
            self._typed = text
        imgui.pop_item_flag()
        if imgui.is_item_deactivated() and self._typed is not None:
            text, self._typed = self._typed.strip(), None
            if not self._window.edit.rename(text):
                self._window.line = f"{text!r} cannot be its name"

    def _tools(self) -> None:
        from imgui_bundle import imgui

        for kind, text in TOOLS.items():
            if imgui.radio_button(text, self._window.tool == kind):
                self._window.tool = kind
            if kind != "boxes":
                imgui.same_line()
        if self._window.subject.free is not None:
            edit = self._window.edit
            self._buttons({"Grow": lambda: edit.grow(1), "Shrink": lambda: edit.grow(-1)})

    def _views(self, scale: float) -> None:
        from imgui_bundle import imgui

        window, subject = self._window, self._window.subject
        views, shown = subject.views, subject.view_shown()
        if subject.free is None:
            at = views.index(shown)
            imgui.text(f"Photograph {at + 1} of {len(views)}")
            self._buttons({"Previous": lambda: window.turn_page(-1), "Next": lambda: window.turn_page(1)})
            if len(views) > 1:
                imgui.set_next_item_width(-1.0)
                moved, chosen = imgui.slider_int("##photograph", at + 1, 1, len(views), shown.replace("%", "%%"))
                if moved:
                    window.go_to(views[min(max(chosen, 1), len(views)) - 1])
        marked = sorted({m.view for m in window.edit.state.marks})
        imgui.text("With marks:" if marked else "None has marks yet")
        imgui.begin_child("views", (0.0, min(len(marked), LIST_ROWS) * imgui.get_text_line_height_with_spacing() + 1))
        for name in marked:
            if imgui.selectable(f"{name}##view", name == shown)[0]:
                window.go_to(name)
        imgui.end_child()

    def _buttons(self, actions: dict) -> None:
        """Buttons in a row."""
        from imgui_bundle import imgui

        for k, (text, act) in enumerate(actions.items()):
            if k:
                imgui.same_line()
            if imgui.button(text):
                act()
