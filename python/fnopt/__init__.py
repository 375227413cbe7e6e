"""Neural cloth: scenes, simulations and rollouts, with states as NumPy arrays in SI units.

    import fnopt

    rollout = fnopt.rollout("sphere", solver="spectral")
    rollout.positions[100]                 # float32 [particles, 3], metres, the scene's axes

    simulation = fnopt.Simulation(fnopt.Scene(), solver="spectral")
    simulation.step()
    simulation.positions                   # float32 [cloths, particles, 3]
"""

from ._fnopt import (
    Control,
    NonFiniteError,
    Rollout,
    Scene,
    Simulation,
    Snapshot,
    __version__,
    adapters,
    chamfer,
    compare,
    intersections,
    rollout,
    solvers,
    soundness,
)

__all__ = [
    "Control",
    "NonFiniteError",
    "Rollout",
    "Scene",
    "Simulation",
    "Snapshot",
    "__version__",
    "adapters",
    "chamfer",
    "compare",
    "intersections",
    "rollout",
    "solvers",
    "soundness",
]
