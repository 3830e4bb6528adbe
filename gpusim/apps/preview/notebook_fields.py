"""Fields of the widget in Jupyter."""

from math import isfinite, log10

import ipywidgets
from ipywidgets import HBox, Layout

from gpusim.apps.preview.control import PLACES, Control


class Number(HBox):
    """A slider and a number field, which also takes values beyond the slider's ends.

    Args:
        control: Control.
        has_switch: Whether a switch sets the control to its `off`.
        on_change: Function that is called with a new value, and with True if the slider was moved.

    Attributes:
        slider: Slider between the ends of the control.
        number: Field that also takes values beyond them.
        switch: Checkbox, or None.
    """

    def __init__(self, control: Control, has_switch: bool, on_change):
        self._control, ends = control, (control.low, control.high)
        low, high = map(log10, ends) if control.is_log else ends
        kind = ipywidgets.FloatLogSlider if control.is_log else ipywidgets.FloatSlider
        # until there is a value
        middle = 10 ** ((low + high) / 2) if control.is_log else (low + high) / 2
        self.slider = kind(
            middle,
            min=low,
            max=high,
            step=(high - low) / PLACES,
            readout=False,
            layout=Layout(flex="1 1 6em", min_width="6em"),
        )
        self.number = ipywidgets.FloatText(middle, layout=Layout(width="6.5em"))
        self.switch = None
        if has_switch:
            self.switch = ipywidgets.Checkbox(indent=False, layout=Layout(width="1.5em"))
        unit = f" [{control.unit}]" if control.unit else ""
        self.slider.observe(lambda change: on_change(float(f"{change.new:.4g}"), True), "value")
        self.number.observe(
            lambda change: on_change(change.new) if isfinite(change.new) else None, "value"
        )
        if self.switch:
            self.switch.observe(
                lambda change: on_change(self.number.value if change.new else control.off), "value"
            )
        label = ipywidgets.Label(control.label + unit, layout=Layout(width="10.5em"))
        parts = [label, self.slider, self.number]
        super().__init__([self.switch, *parts] if self.switch else parts)

    def show(self, value):
        """Show a value. A control that is off, or has no number, is greyed out."""
        control = self._control
        has_number = isinstance(value, int | float) and value != control.off
        if has_number:
            # not the moving slider: the value would arrive after it has moved on
            if f"{value:.4g}" != f"{self.slider.value:.4g}":
                self.slider.value = min(max(value, control.low), control.high)
            self.number.value = value
        self.slider.disabled = self.number.disabled = not has_number
        if self.switch:
            self.switch.value = has_number
