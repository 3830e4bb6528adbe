"""Fields of the widget in Jupyter."""

from html import escape
from math import isfinite

import ipywidgets
from ipywidgets import HTML, HBox, Layout

from gpusim.apps.preview.control import Control


class Number(HBox):
    """A slider and a number field, which also takes values beyond the slider's ends.

    Args:
        control: Control.
        has_switch: Whether a switch sets the control to its `off`.
        on_change: Function that is called with a new value, and with True if the slider was moved.

    Attributes:
        slider: Slider whose value is a place, 0 .. `control.places`. A browser moves a slider that
            stands between two steps to one of them, and sends that back as a change: so it has
            whole places in place of the control's values.
        number: Field that also takes values beyond them.
        switch: Checkbox, or None.
    """

    def __init__(self, control: Control, has_switch: bool, on_change):
        self._control, self._on_change = control, on_change
        self._is_showing = False  # True while the camera's choice changes the fields
        middle = control.places // 2  # until there is a value
        self.slider = ipywidgets.IntSlider(
            middle,
            max=control.places,
            readout=False,
            layout=Layout(flex="1 1 6em", min_width="6em"),
        )
        self.number = ipywidgets.FloatText(
            control.to_value(middle), layout=Layout(width="6.5em", flex="0 0 auto")
        )
        self.switch = None
        if has_switch:
            self.switch = ipywidgets.Checkbox(
                indent=False, layout=Layout(width="1.5em", flex="0 0 auto")
            )
        self.slider.observe(lambda change: self._set(control.to_value(change.new), True), "value")
        self.number.observe(
            lambda change: self._set(change.new) if isfinite(change.new) else None, "value"
        )
        if self.switch:
            self.switch.observe(
                lambda change: on_change(self.number.value if change.new else control.off), "value"
            )
        unit = f" [{control.unit}]" if control.unit else ""
        label = HTML(
            f'<div style="line-height:1.15">{escape(control.label + unit)}</div>',
            layout=Layout(width="8.5em", flex="0 0 auto"),
        )
        parts = [label, self.slider, self.number]
        super().__init__(
            [self.switch, *parts] if self.switch else parts, layout=Layout(align_items="center")
        )

    def _set(self, value, is_slid=False):
        if not self._is_showing:
            self._on_change(value, is_slid)

    def show(self, value):
        """Show a value. A control that is off, or has no number, is greyed out."""
        control = self._control
        has_number = isinstance(value, int | float) and value != control.off
        if has_number:
            self._put(value)
        self.slider.disabled = self.number.disabled = not has_number
        if self.switch:
            self.switch.value = has_number

    def show_metered(self, value: float):
        """Show what the camera chose, if the control is off."""
        if self.slider.disabled:
            self._is_showing = True
            try:
                self._put(float(f"{value:.4g}"))
            finally:
                self._is_showing = False

    def _put(self, value):
        self.slider.value = self._control.to_place(value)
        self.number.value = value
