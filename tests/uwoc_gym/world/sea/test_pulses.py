from __future__ import annotations

from uwoc_gym import Pulse, Sea


def test_pulse_in_earth_frame_pushes_along_x(fly, below_a_still_ship):
    pulse = Pulse(start_s=0.0, duration_s=0.5, force_x_n=300.0, force_y_n=0.0, moment_nm=0.0, frame="earth")
    state = fly(below_a_still_ship(sea=Sea(pulses=(pulse,))), pose=(0, 0, 1.0), velocity=(0, 0, 0)).step()
    surge, sway, _ = state["velocity"][0]
    # The push along x is seen from a body turned by 1 rad.
    assert surge > 0.0
    assert sway < 0.0
