"""The eddy-current instrument and the procedure, table ``[instrument]``: the highest speed at which they inspect."""

import math
from typing import Annotated, Final, Self

from pydantic import model_validator

from probe_env.settings import Model, quantity

FLAW_BAND: Final = 2.0
"""Upper end of a flaw's band in units of u/w, speed over width; see ``Instrument.speeds``."""
CARRIER_FRACTION: Final = 0.25
"""Greatest bandwidth of a demodulated signal as a share of the test frequency; see ``Instrument.speeds``."""


class Instrument(Model):
    """Sampling, filter and test frequency of the instrument, and limits of the procedure; all optional."""

    sample_rate: Annotated[float, quantity(1.0, 1e6, "Hz")] | None = None
    """Samples per second; with ``samples_per_mm``."""
    samples_per_mm: Annotated[float, quantity(0.01, 1e3, "1/mm")] | None = None
    """Samples per millimetre that the procedure asks for. For n samples in a flaw of width w [mm] it is n / w."""
    bandwidth: Annotated[float, quantity(0.1, 1e6, "Hz")] | None = None
    """Cut-off frequency of the low-pass filter of the demodulated signal."""
    test_frequency: Annotated[float, quantity(1.0, 1e7, "Hz")] | None = None
    """Lowest test frequency in use."""
    highest_speed: Annotated[float, quantity(1e-3, 2.0, "m/s")] | None = None
    """Highest speed of the procedure, such as that of its qualification."""
    highest_a90: Annotated[float, quantity(1.0, 100.0, "% of the wall")] | None = None
    """Largest a90 that the procedure accepts [% of the wall]: schedules that miss such flaws are not advised."""
    repeat_length: Annotated[float, quantity(0.1, 100.0, "m")] = 2.0
    """Length of the shortest interval to repeat; shorter gaps between two intervals are repeated, too."""

    @model_validator(mode="after")
    def _samples_need_both(self) -> Self:
        if (self.sample_rate is None) != (self.samples_per_mm is None):
            missing = "sample_rate" if self.sample_rate is None else "samples_per_mm"
            raise ValueError(f"sample_rate and samples_per_mm go together: {missing} is missing")
        return self

    def speeds(self, flaw_width: float) -> dict[str, float]:
        """Highest speed of the sensor [m/s] by each requirement that is set.

        * ``sample_rate``: v = sample rate / samples per metre.
        * ``bandwidth``: v = B w / 2. The signal of a flaw of width w at speed v has the spectrum |G(f w / v)| of the
          sensor model, which peaks at v/w. Below 2 v/w it has 95 % of its energy, erf(2) - 4 exp(-4) / sqrt(pi); a
          low-pass filter with this cut-off keeps 90 % of the amplitude (ideal 92 %, Butterworth of order 1, 2 and 4:
          87, 90 and 98 %). The rule f > v / (effective coil width) of Rohmann's page on low-pass filters
          (rohmann.de/en/faq/low-pass-filters) is half of it.
        * ``test_frequency``: the same with B = f/4, an assumption. A demodulated signal of bandwidth B has an image at
          2 f - B. At B = f/4 that is seven times B: a filter of second order with cut-off B leaves 2 % of the image. No
          figure was found in a source that could be read. That the excitation frequency limits the channel's
          bandwidth, and so the speed, see Guerard et al. on remote-field testing (ndt.net/?id=21592).
        * ``highest_speed`` itself.

        Args:
            flaw_width: length of the shortest flaw's signal [m].
        """
        per_hertz = flaw_width / FLAW_BAND
        speeds = {
            "sample_rate": self.sample_rate and self.samples_per_mm and self.sample_rate / (1e3 * self.samples_per_mm),
            "bandwidth": self.bandwidth and self.bandwidth * per_hertz,
            "test_frequency": self.test_frequency and CARRIER_FRACTION * self.test_frequency * per_hertz,
            "highest_speed": self.highest_speed,
        }
        return {name: speed for name, speed in speeds.items() if speed is not None}

    def permitted(self, flaw_width: float) -> tuple[float, str]:
        """Highest permitted speed of the sensor [m/s] and the requirement that sets it; infinite and "" without one."""
        speeds = self.speeds(flaw_width)
        name = min(speeds, key=speeds.__getitem__, default="")
        return speeds.get(name, math.inf), name
