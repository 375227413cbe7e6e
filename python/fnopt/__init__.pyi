import os
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple, Union

import numpy as np
import numpy.typing as npt

__version__: str

Path = Union[str, "os.PathLike[str]"]
Grid = Union[int, Tuple[int, int]]

class NonFiniteError(RuntimeError):
    """A simulation that became non-finite. `rollout` is there if `fnopt.rollout` raised it: the frames before."""

    frame: int
    cloth: int
    rollout: Rollout

class Scene:
    """A cloth, the forces on it and the motion of its handles, in SI units and the scene's axes. Never changes."""

    def __init__(self) -> None: ...
    @staticmethod
    def from_file(path: Path, *, grid: Optional[Grid] = None, frames: Optional[int] = None) -> Scene:
        """Reads a scene file, or returns the scene of this name that comes with the library."""
    @staticmethod
    def from_dict(fields: Dict[str, Any], folder: Optional[Path] = None) -> Scene:
        """Reads a scene from a dict with the fields of scene files. Relative paths are those of `folder`."""
    @staticmethod
    def names() -> Dict[str, str]:
        """The scenes that come with the library: their names, each with what happens in it."""
    def replace(self, **fields: Any) -> Scene:
        """A copy with other values of these fields, which are those of scene files."""
    def to_dict(self) -> Dict[str, Any]:
        """The scene as a dict with the fields of scene files."""
    @property
    def grid(self) -> Tuple[int, int]:
        """Particles along the height and the width."""
    @property
    def frames(self) -> Optional[int]:
        """Number of frames, including the start; None for the length of the motion."""
    @property
    def frame_dt(self) -> float:
        """Duration of a frame [s]."""
    @property
    def origin(self) -> str:
        """Where it comes from, for error messages."""

SceneLike = Union[Scene, Dict[str, Any], Path]

class Control:
    """What to prescribe in a step, in SI units and the scene's axes. What is None is as in the scene."""

    handles: Optional[npt.ArrayLike]
    """Targets of the handles [m], [handles, 3]: all of cloth 0, then of cloth 1, and so on."""
    wind: Optional[npt.ArrayLike]
    """Wind velocity [m/s], [3] or [cloths, 3]."""
    accelerations: Optional[npt.ArrayLike]
    """Accelerations [m/s^2] in addition to gravity and air, [3], [particles, 3] or [cloths, particles, 3]."""
    bodies: Optional[npt.ArrayLike]
    """Where the bodies are at the end of the frame, [bodies, 7]: position [m] and quaternion (x, y, z, w)."""

    def __init__(
        self,
        handles: Optional[npt.ArrayLike] = None,
        wind: Optional[npt.ArrayLike] = None,
        accelerations: Optional[npt.ArrayLike] = None,
        bodies: Optional[npt.ArrayLike] = None,
    ) -> None: ...

class Snapshot:
    """A simulation at one of its frames, from which it goes on to the same bits."""

class Simulation:
    """One cloth or a batch of cloths on one grid, advancing frame by frame. Particle (i, j) has number i W + j."""

    def __init__(
        self,
        scene: Union[SceneLike, Sequence[SceneLike]],
        solver: str = "fnopt",
        iterations: Optional[int] = None,
        device: str = "auto",
        adapter: Optional[str] = None,
        cloths: int = 1,
        *,
        checkpoint: Optional[Path] = None,
        precision: str = "f32",
    ) -> None: ...
    def step(self, control: Optional[Control] = None) -> None:
        """Computes the next frame as the scene has it, but for what `control` prescribes."""
    def control(self) -> Control:
        """What the scene prescribes in the next step, as a start for a control of one's own."""
    @property
    def positions(self) -> npt.NDArray[np.float32]:
        """Positions [m], [cloths, particles, 3]; a new array at each access."""
    @property
    def velocities(self) -> npt.NDArray[np.float32]:
        """Velocities [m/s], [cloths, particles, 3]; a new array at each access."""
    @property
    def faces(self) -> npt.NDArray[np.uint32]:
        """Triangles of a cloth, [triangles, 3]."""
    @property
    def uv(self) -> npt.NDArray[np.float32]:
        """Texture coordinates of a cloth, [particles, 2]."""
    @property
    def handles(self) -> List[npt.NDArray[np.uint64]]:
        """Particles that are held now, an array for each cloth."""
    @property
    def bodies(self) -> npt.NDArray[np.float64]:
        """Where the bodies are at the end of the last frame, [bodies, 7]: position [m] and quaternion (x, y, z, w)."""
    @property
    def frame(self) -> int:
        """Number of the last frame; the start is 0."""
    @property
    def frames(self) -> int:
        """Number of frames of the scene, including the start."""
    @property
    def time(self) -> float:
        """Time since the start [s]."""
    @property
    def frame_dt(self) -> float:
        """Duration of a frame [s]."""
    @property
    def grid(self) -> Tuple[int, int]:
        """Particles along the height and the width."""
    @property
    def cloths(self) -> int:
        """Number of cloths."""
    @property
    def particle_count(self) -> int:
        """Number of particles of a cloth."""
    @property
    def device(self) -> str:
        """The device that computes."""
    @property
    def stats(self) -> List[Dict[str, Any]]:
        """What each cloth was like in the last frame, with the fields of `per_frame` in a report."""
    def set_state(
        self,
        positions: npt.ArrayLike,
        velocities: Optional[npt.ArrayLike] = None,
        *,
        cloth: Optional[int] = None,
    ) -> None:
        """Replaces positions [m] and velocities [m/s] of all cloths, or of one. Frames are counted on."""
    def reset(self) -> None:
        """Goes back to the start of the scene."""
    def snapshot(self) -> Snapshot:
        """The simulation as it is now, for `restore`."""
    def restore(self, snapshot: Snapshot) -> None:
        """Goes on from a snapshot, to the same bits."""

class Rollout:
    """The frames of a rollout of one cloth. Positions and velocities are views, which cannot be written to."""

    @property
    def positions(self) -> npt.NDArray[np.float32]:
        """Positions [m], [frames, particles, 3]."""
    @property
    def velocities(self) -> npt.NDArray[np.float32]:
        """Velocities [m/s], [frames, particles, 3]."""
    @property
    def faces(self) -> npt.NDArray[np.uint32]:
        """Triangles, [triangles, 3]."""
    @property
    def uv(self) -> npt.NDArray[np.float32]:
        """Texture coordinates, [particles, 2]."""
    @property
    def fps(self) -> float:
        """Frames per second [1/s]."""
    @property
    def grid(self) -> Tuple[int, int]:
        """Particles along the height and the width."""
    @property
    def report(self) -> Dict[str, Any]:
        """The report, with the fields of the command's report.json but for `files` and `intersections`."""
    @property
    def status(self) -> str:
        """How it ended: "done", "interrupted", "non-finite" or "failed"."""
    @property
    def sound(self) -> bool:
        """Whether it can be trusted: no edge stretched more than cloth, no frame far from its minimum."""
    def save(
        self,
        path: Path,
        format: Optional[str] = None,
        *,
        fps: Optional[float] = None,
        start_frame: int = 0,
        half: bool = False,
        compress: bool = False,
    ) -> Path:
        """Writes the frames as npz, npy, obj, ply, pc2, mdd, usda or glb, and returns the path. `fps` is the rate that the
        file names, `start_frame` the number of its first frame; `half` keeps 16 bits of each number, `compress` deflates."""
    def __len__(self) -> int: ...

def rollout(
    scene: SceneLike,
    solver: str = "fnopt",
    *,
    iterations: Optional[int] = None,
    frames: Optional[int] = None,
    device: str = "auto",
    adapter: Optional[str] = None,
    checkpoint: Optional[Path] = None,
    precision: str = "f32",
    progress: bool = True,
) -> Rollout:
    """Simulates the frames of a scene. KeyboardInterrupt, NonFiniteError and the RuntimeError of a device have the frames
    until then in `rollout`."""

def solvers() -> Dict[str, Mapping[str, Any]]:
    """The solvers by name: `iterations` per frame where none are given, and the `devices` that run them."""

def adapters() -> List[Dict[str, Any]]:
    """The adapters of this machine, in the order in which "0", "1", .. number them."""

def compare(found: npt.ArrayLike, truth: npt.ArrayLike) -> Dict[str, npt.NDArray[np.float64]]:
    """Distances of frames [frames, particles, 3] from true ones: `distance_mean`, `distance_largest` [m] and
    `relative_error`, each [frames]."""

def chamfer(a: npt.ArrayLike, b: npt.ArrayLike) -> float:
    """The Chamfer distance of two clouds of points, [points, 3] each [m^2]."""

def intersections(positions: npt.ArrayLike, grid: Grid) -> npt.NDArray[np.uint32]:
    """Where a cloth passes through itself: [found, 3], the ends of an edge and the triangle it passes through."""

def soundness(
    scene: SceneLike, positions: npt.ArrayLike, velocities: Optional[npt.ArrayLike] = None
) -> Dict[str, Any]:
    """Judges frames of a scene, [frames, particles, 3] in metres, whoever computed them."""
