"""The libraries, and what each one's environment is made of."""

from __future__ import annotations

from typing import NamedTuple


class Library(NamedTuple):
    """A library that is tried, by the script of its name."""

    title: str
    requirements: tuple[str, ...]
    """What pip is asked for."""
    shown: tuple[str, ...]
    """The distributions whose versions stand in the table."""
    afterwards: tuple[str, ...] = ()
    """What is installed then without its own requirements, against the library's."""
    remark: str = ""


LIBRARIES: dict[str, Library] = {
    "gymnasium": Library(
        "Gymnasium",
        (
            "gymnasium>=1.2",
            "array-api-compat",
            "packaging",
            "imageio-ffmpeg",
            "moviepy",
            "opencv-python-headless",
            "pygame",
        ),
        ("gymnasium",),
    ),
    "stable_baselines3": Library(
        "Stable-Baselines3", ("stable-baselines3", "sb3-contrib"), ("stable-baselines3", "sb3-contrib")
    ),
    "rl_zoo3": Library("rl-baselines3-zoo", ("rl_zoo3", "requests"), ("rl_zoo3",)),
    "minari": Library("Minari", ("minari[hdf5,create]", "pillow", "tqdm"), ("minari",)),
    "torchrl": Library("TorchRL", ("torchrl",), ("torchrl",)),
    "tianshou": Library("Tianshou", ("tianshou",), ("tianshou",)),
    "skrl": Library("skrl", ("skrl[torch]",), ("skrl",)),
    "agilerl": Library("AgileRL", ("agilerl", "peft"), ("agilerl",)),
    "rllib": Library("RLlib", ("ray[rllib]",), ("ray",), remark="asks for gymnasium==1.2.2"),
    "ray_tune": Library("Ray Tune", ("ray[tune]",), ("ray",)),
    "d3rlpy": Library(
        "d3rlpy",
        ("d3rlpy", "minari[hdf5]", "pillow", "tqdm"),
        ("d3rlpy",),
        afterwards=("gymnasium>=1.2",),
        remark="asks for gymnasium==1.0.0, which this package doesn't run on; tried with a newer one all the same",
    ),
    "torch": Library("CleanRL's way", (), ("torch",), remark="one file of plain PyTorch"),
}
"""By the end of their script's name."""

ALWAYS = ("numba>=0.61", "numpy>=2.0", "scipy>=1.14")
"""What this package needs besides Gymnasium, which a library may want older."""
