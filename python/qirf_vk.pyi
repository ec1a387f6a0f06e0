"""3D Gaussian Splatting with Vulkan compute: models, pictures, training, compression, scores.

Units: positions and sizes in world units, pictures in [0, 1], angles in degrees, PSNR in dB, seconds. Cameras have x right, y down, z forward;
the middle of the first pixel is (0.5, 0.5). Functions raise ValueError for arguments and file contents that are wrong, FileNotFoundError and other
OSErrors for files, MemoryError, DeviceError, KeyboardInterrupt after Ctrl-C, and RuntimeError in a process that was forked after first use.
"""

from os import PathLike
from pathlib import Path
from typing import Any, Callable, Optional, Sequence, Union, final, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

__version__: str
__all__ = [
    "__version__", "DeviceError", "Model", "Device", "Camera", "View", "Renderer", "Run", "merge",
    "train", "compress", "evaluate", "orbit", "cameras", "_model", "_camera",
]

_Path = Union[str, bytes, PathLike[str], PathLike[bytes]]
_Vector = Union[Sequence[float], NDArray[Any]]
_Resolution = Union[int, str]
_Size = Union[tuple[int, int], Sequence[int], NDArray[np.integer[Any]]]
_Step = dict[str, Any]
_OnStep = Callable[[_Step], object]
_OnProgress = Callable[[str, int, int], object]

class DeviceError(RuntimeError):
    """A device that is missing, unsuitable or lost, or that computes wrong numbers."""

@final
class Device:
    """A Vulkan device by its index, a part of its name, "uuid:..." or "pci:..."; by default $QIRF_DEVICE, else the best device.

    memory_limit: limit on the bytes in use; by default the free memory of a GPU. Raises DeviceError.
    """

    def __new__(cls, name: Union[int, str, None] = None, *, memory_limit: Optional[int] = None) -> Device: ...

    @staticmethod
    def list() -> list[str]:
        """Names of all devices, in the order of their indices."""

    @property
    def name(self) -> str:
        """Its name, as the driver gives it."""

    @property
    def memory_used(self) -> int:
        """Bytes in its buffers now."""

    @property
    def memory_limit(self) -> int:
        """Bytes that may be used."""

@final
class Model:
    """A model of n Gaussians on the host, made by load, from_arrays and functions. It never changes: edits return new models. Arrays are
    read-only views of its memory. Models can be pickled; copies are the model itself, and a model equals only itself.

    A model of train, or loaded from beside a run's config.toml, remembers how its run draws and scores it: dilation, depth order, background and
    exposures. Edits, compress and pickles keep that; Renderer, evaluate and compress use it for arguments that are None, as the program does,
    and say so in the log.
    """

    @staticmethod
    def load(path: _Path) -> Model:
        """Reads .ply, .spz, .splat, .ksplat, .sog, .glb, .gltf, .usda, .usdz, or a SOG folder; Gaussians that are not finite or have no rotation
        are left out, with a UserWarning, which also tells of an unclear tag and of a file without Gaussians.
        """

    @staticmethod
    def from_arrays(
        means: ArrayLike,
        log_scales: ArrayLike,
        rotations: ArrayLike,
        opacity_logits: ArrayLike,
        sh: Union[Sequence[ArrayLike], ArrayLike],
        *,
        antialiased: bool = False,
        origin: _Vector = (0.0, 0.0, 0.0),
    ) -> Model:
        """Copies arrays, as float32; ValueError names the first Gaussian that cannot be drawn. A UserWarning tells of positions that float32
        rounds far from the origin, such as map coordinates: give means - c with origin=c.

        means (n, 3); log_scales (n, 3), natural logarithms of standard deviations, below 30; rotations (n, 4), quaternions w, x, y, z;
        opacity_logits (n,); sh: a list of bands (n, 2 l + 1, 3) for l = 0 to L, or all coefficients (n, (L + 1)^2, 3), as an array or
        nested lists; L is 0 to 3; origin: see Model.origin.
        """

    def save(self, path: _Path, *, sh_bits: Union[int, Sequence[int], None] = None, spz_version: int = 4) -> None:
        """Writes .ply, .compressed.ply, .spz, .sog, .glb, .gltf, .usda or .usdz, completely or not at all; an origin is written to georeference.json
        beside it. A model without Gaussians is a ValueError, and so is the name of a run's own model, which its figures describe.

        sh_bits: bits of SH coefficients in an SPZ, 1 to 8, or two numbers: of band 1, and of the others. By default they are the usual ones, not
        chosen by pictures as `qirf-vk convert` does: compress(model, 1, output="x.spz") chooses them. spz_version: 4, or 3 for readers from
        before 2026.
        """

    @property
    def means(self) -> NDArray[np.float32]:
        """Centres in world units, (n, 3)."""

    @property
    def log_scales(self) -> NDArray[np.float32]:
        """Natural logarithms of the axes' standard deviations, (n, 3)."""

    @property
    def rotations(self) -> NDArray[np.float32]:
        """Quaternions w, x, y, z of any length, (n, 4)."""

    @property
    def opacity_logits(self) -> NDArray[np.float32]:
        """Opacities before the sigmoid, (n,)."""

    @property
    def sh(self) -> list[NDArray[np.float32]]:
        """Spherical harmonics by degree, (n, 2 l + 1, 3) for l = 0 to L: coefficients m = -l to l, each red, green, blue."""

    @property
    def degree(self) -> int:
        """The SH degree L."""

    @property
    def antialiased(self) -> bool:
        """True if it has to be drawn with anti-aliasing."""

    @property
    def origin(self) -> tuple[float, float, float]:
        """Local origin of the means in the world; (0, 0, 0) except for models far from the world's origin, such as those in map coordinates. Edits keep it."""

    def __len__(self) -> int: ...
    def __copy__(self) -> Model: ...
    def __deepcopy__(self, memo: dict[int, Any]) -> Model: ...
    def transform(self, matrix: ArrayLike) -> Model:
        """Applies a similarity, (3, 4) or (4, 4), and rotates the spherical harmonics accordingly. Like move_by, turn and scale, warns if float32
        rounds positions far from the origin.
        """

    def move_by(self, offset: _Vector) -> Model:
        """Translates by (x, y, z) in world units."""

    def turn(self, axis: _Vector, degrees: float) -> Model:
        """Rotates about an axis through the origin (right-handed)."""

    def scale(self, factor: float) -> Model:
        """Scales about the origin."""

    def crop_box(self, low: _Vector, high: _Vector, *, outside: bool = False) -> Model:
        """Keeps the Gaussians with their centre in an axis-aligned box, or outside of it."""

    def crop_ball(self, centre: _Vector, radius: float, *, outside: bool = False) -> Model:
        """Keeps the Gaussians with their centre in a sphere, or outside of it."""

    def crop_views(
        self, scene: _Path, *, images: Optional[_Path] = None, least: int = 1, outside: bool = False
    ) -> Model:
        """Keeps the Gaussians with their centre in the view of at least `least` of a scene's cameras, occluded or not, or the others. images:
        the folder of its photos, such as "images_4". Tells of the scene as cameras does.
        """

    def with_degree(self, degree: int) -> Model:
        """Drops the bands above this SH degree."""

    def min_opacity(self, opacity: float) -> Model:
        """Removes Gaussians with a lower opacity, 0 to 1."""

    def max_size(self, size: float) -> Model:
        """Removes Gaussians whose longest axis has a larger standard deviation, in world units."""

    def remove(
        self,
        kind: str,
        *,
        ratio: Optional[float] = None,
        scene: Optional[_Path] = None,
        images: Optional[_Path] = None,
        resolution: Optional[_Resolution] = None,
        device: Optional[Device] = None,
    ) -> Model:
        """Removes "invisible" Gaussians, which no picture can show; or "needles", whose longest axis is `ratio` times the middle one, 100 by
        default; or "floaters", Gaussians in empty space, which the photos of `scene`, in its folder images and at a resolution such as 640
        (pixels wide) or "/2", show to be wrong, or without a scene pictures of the model (docs/edit.md). A UserWarning tells of very many
        floaters.
        """

    def morton_order(self) -> Model:
        """Orders Gaussians along a Z-order curve, so that neighbours in space are neighbours in the file."""

    def select(self, chosen: Union[ArrayLike, slice]) -> Model:
        """The Gaussians selected by a mask (n,) of bools, by indices (k,), in their order, or by a slice. Negative indices count from the end."""

def merge(models: Sequence[Model]) -> Model:
    """Concatenates models; SH bands that one lacks are zero. The result has the origin of the first model, unless another one's is
    much nearer to all. It remembers a run (see Model) if all remember the same.
    """

@final
class Camera:
    """A pinhole camera with the axes of COLMAP and OpenCV: x right, y down, z forward; the centre of the first pixel is (0.5, 0.5).

    K: (3, 3) in pixels, [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]. world_to_camera: (3, 4) or (4, 4). size: width and height in pixels.
    near: near plane, in world units along the camera's axis; closer Gaussians are not drawn. 0.2 by default, which small models need less of:
    the cameras of `orbit` and `cameras` have one that fits. For a model with an origin, world_to_camera counts from it, as the means do: of a
    pose P in the world it is P with P[:3, 3] + P[:3, :3] @ origin. Cameras can be pickled; a camera equals only itself.
    """

    def __new__(cls, K: ArrayLike, world_to_camera: ArrayLike, size: _Size, *, near: Optional[float] = None) -> Camera: ...

    @staticmethod
    def look_at(
        eye: _Vector,
        target: _Vector = (0.0, 0.0, 0.0),
        *,
        up: _Vector = (0.0, -1.0, 0.0),
        fov: float = 40.0,
        size: _Size = (1280, 720),
        near: Optional[float] = None,
    ) -> Camera:
        """A camera at `eye` that looks at `target`; fov is vertical, in degrees."""

    @property
    def near(self) -> Optional[float]:
        """The near plane, in world units along the camera's axis; None for the usual distance, 0.2."""

    @property
    def centre(self) -> tuple[float, float, float]:
        """The camera's place in the world, (x, y, z)."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""

    @property
    def K(self) -> NDArray[np.float64]:
        """The intrinsic matrix in pixels, (3, 3)."""

    @property
    def world_to_camera(self) -> NDArray[np.float64]:
        """The pose, (4, 4)."""

    def __copy__(self) -> Camera: ...
    def __deepcopy__(self, memo: dict[int, Any]) -> Camera: ...

def orbit(
    model: Model,
    count: int,
    *,
    size: _Size = (1280, 720),
    fov: float = 40.0,
    elevation: float = 15.0,
    up: _Vector = (0.0, -1.0, 0.0),
) -> list[Camera]:
    """Cameras on a circle around a model, those of `qirf-vk render --orbit`; fov is vertical, elevation above the horizon, in degrees."""

@final
class View:
    """A view of a scene, made by cameras."""

    @property
    def name(self) -> str:
        """The photo's name; that of a face of a panorama has the face before the extension."""

    @property
    def camera(self) -> Camera:
        """The camera of the picture that is compared with the photo."""

    @property
    def held_out(self) -> bool:
        """True if the photo is held out."""

def cameras(
    scene: _Path,
    *,
    resolution: Optional[_Resolution] = None,
    images: Optional[_Path] = None,
    eval_every: Optional[int] = None,
) -> list[View]:
    """The views of a scene that train and evaluate use, in the order of their names: Renderer(model).render(view.camera) is the picture that is
    compared with the photo, before exposures, on the background of the scores.

    resolution, images and eval_every: as in evaluate; eval_every=0 holds out none. Photos that do not exist or have another shape than their
    camera are left out; photos are not decoded, so damaged ones, which train leaves out before the split, are among the views. UserWarnings
    tell of what is left out, ignored or doubtful; the log, at INFO, of choices by which nothing is lost, such as the folder of the photos.

    Cameras are ideal pinholes: distorted photos are resampled to them, panoramas and wide fisheyes are cut into faces with a view each. They
    count from the scene's local origin, where it has one, as the model of a run on it does (Model.origin), and have the scene's near plane.
    """

@final
class Renderer:
    """Draws pictures of one model, in parts if the device cannot hold it.

    background: red, green and blue in [0, 1]. antialias, dilation (in square pixels) and depth_order: as in `qirf-vk render`; by default as in
    the model's run (see Model), else black, and anti-aliased if the model is, with a dilation of 0.1 then and of 0.3 otherwise. Cameras count
    from the model's origin, as its means do. A renderer keeps the model on the device, so use one renderer for many pictures.
    """

    def __new__(
        cls,
        model: Model,
        device: Optional[Device] = None,
        *,
        background: Optional[_Vector] = None,
        antialias: Optional[bool] = None,
        dilation: Optional[float] = None,
        depth_order: Optional[bool] = None,
    ) -> Renderer: ...
    @overload
    def render(
        self,
        camera: Camera,
        world_to_camera: None = None,
        size: None = None,
        *,
        near: Optional[float] = None,
        K: None = None,
    ) -> NDArray[np.float32]: ...
    @overload
    def render(
        self,
        camera: ArrayLike,
        world_to_camera: ArrayLike,
        size: _Size,
        *,
        near: Optional[float] = None,
        K: None = None,
    ) -> NDArray[np.float32]: ...
    @overload
    def render(
        self,
        camera: None = None,
        *,
        world_to_camera: ArrayLike,
        size: _Size,
        near: Optional[float] = None,
        K: ArrayLike,
    ) -> NDArray[np.float32]:
        """A picture (height, width, 4): red, green, blue over the background, and alpha. Pass a Camera, or K (3, 3), the pose
        (3, 4) or (4, 4), and width and height. The bytes are those of `qirf-vk render --format npy`.
        """

    @overload
    def depth(
        self,
        camera: Camera,
        world_to_camera: None = None,
        size: None = None,
        *,
        kind: str = "expected",
        near: Optional[float] = None,
        K: None = None,
    ) -> NDArray[np.float32]: ...
    @overload
    def depth(
        self,
        camera: ArrayLike,
        world_to_camera: ArrayLike,
        size: _Size,
        *,
        kind: str = "expected",
        near: Optional[float] = None,
        K: None = None,
    ) -> NDArray[np.float32]: ...
    @overload
    def depth(
        self,
        camera: None = None,
        *,
        world_to_camera: ArrayLike,
        size: _Size,
        kind: str = "expected",
        near: Optional[float] = None,
        K: ArrayLike,
    ) -> NDArray[np.float32]:
        """Depths (height, width) along the camera's axis, in world units. kind: "expected", the mean over the Gaussians that a pixel blends,
        with the weights of their colours, infinite where there are none; or "median", the depth at which the transmittance falls to a
        half, infinite where it does not.
        """

@final
class Run:
    """A finished run, made by train. It cannot be pickled: send its model, record and log."""

    @property
    def model(self) -> Model:
        """The trained, pruned model."""

    @property
    def record(self) -> dict[str, Any]:
        """The contents of metrics.json (docs/metrics.md)."""

    @property
    def log(self) -> list[_Step]:
        """The lines of log.jsonl (docs/metrics.md)."""

    @property
    def folder(self) -> Optional[Path]:
        """The folder of its files; None if it was temporary."""

def train(
    scene: _Path,
    preset: str = "standard",
    *,
    output: Optional[_Path] = None,
    device: Optional[Device] = None,
    resume: bool = False,
    overwrite: bool = False,
    on_step: Optional[_OnStep] = None,
    on_progress: Optional[_OnProgress] = None,
    **options: Any,
) -> Run:
    """Trains a scene with poses, prunes it, and scores it, as `qirf-vk run` does, with the same bytes.

    scene: a folder with COLMAP's, Blender's, instant-ngp's or nerfstudio's cameras and photos. preset: "standard", "quick" or "paper".
    output: the folder of the run's files; a temporary folder by default. resume: continue from the checkpoint of an interrupted run there. overwrite:
    replace a finished run there. The folder of a comparison or of another run's pictures is refused, and so is one with a
    model that is no run's, unless it is the initial one.

    on_step gets a line of log.jsonl as a dictionary: iteration, iterations, seconds, loss (or None), gaussians, psnr if it was measured,
    rates, device_bytes. on_progress gets the stage, the steps done and their total, which never fall within a stage. Both are called in the
    thread that called train. An exception in a callback ends the run.

    options: every key of config.toml, such as seed, resolution (640 pixels wide, or "/2"), images, eval_every, sh_degree, max_gaussians,
    checkpoint_every, background, clean; tables are dicts. train(**tomllib.load(file)) repeats the run whose config.toml that is; its paths
    within the run's folder are relative to it. In a dict as schedule or prune, keys that are left out have the preset's values, and None
    removes one. Short forms: iterations; keep (a share) or count of Gaussians; prune=False; schedule="attrition", "one-shot" or "gradual",
    the schedule of the prune; effects=["exposure=on"] or {"exposure": "on"}; init="random", the path of a model, or a Model, which is written
    to the folder as initial.ply, without its bands above a given sh_degree. Unknown keywords are TypeErrors.
    """

def compress(
    model: Model,
    keep: Optional[float] = None,
    *,
    count: Optional[int] = None,
    size: Union[int, str, None] = None,
    psnr: Optional[float] = None,
    output: Optional[_Path] = None,
    scene: Optional[_Path] = None,
    images: Optional[_Path] = None,
    resolution: Optional[_Resolution] = None,
    eval_every: Optional[int] = None,
    background: Optional[_Vector] = None,
    antialias: Optional[bool] = None,
    dilation: Optional[float] = None,
    depth_order: Optional[bool] = None,
    exposure: Optional[bool] = None,
    selector: Optional[str] = None,
    budget: Optional[str] = None,
    detail: Optional[float] = None,
    merge: Optional[bool] = None,
    fine_tune: int = 0,
    views: Optional[int] = None,
    picture_size: Optional[_Size] = None,
    seed: int = 1,
    device: Optional[Device] = None,
    on_progress: Optional[_OnProgress] = None,
) -> tuple[Model, dict[str, Any]]:
    """Removes redundant Gaussians. Returns the smaller model and the record of `qirf-vk compress --json`.

    keep: the share to keep, 0.28 by default; or count: the number of Gaussians to keep; or size: the maximum size in bytes or as a text
    such as "5MB" or "1165B", with the highest PSNR; or psnr: the minimum PSNR in dB, with the smallest file, and a UserWarning if none
    reaches it. The last two are of `output`, a file name as for Model.save, which is written and read for the returned model; without one,
    of the .ply that the returned model makes. An output that cannot be written is refused before any work.

    The result is compared with `views` pictures of the model itself, of picture_size (width, height), or with the photos of `scene`: those
    in its folder images, at a resolution such as 640 (pixels wide) or "/2", of which every eval_every-th is held out (8 by default).
    background, antialias, dilation, depth_order and exposure: as in evaluate; without a scene the background is black unless given. selector:
    the rule that ranks Gaussians (docs/method.md), "pairs" by default; the others also read budget ("per-block", "hybrid" or "global"),
    detail (the share reserved for small detail) and merge (False drops Gaussians without merging them). fine_tune: iterations of training
    afterwards, left out if they make a file of a given size or psnr worse (record["aim"]["fine_tuning"]).

    record["test"] has mean scores of held-out views: "pruned" and "written" (the file), with photos also "before", after tuning
    "fine_tuned"; each has psnr in dB, None where pictures are equal, and ssim. record["input"] and record["output"] have the bytes of the
    model's .ply where the model is in memory, and None as its path.
    """

def evaluate(
    model: Model,
    scene: Optional[_Path] = None,
    *,
    against: Optional[Model] = None,
    images: Optional[_Path] = None,
    resolution: Optional[_Resolution] = None,
    eval_every: Optional[int] = None,
    background: Optional[_Vector] = None,
    antialias: Optional[bool] = None,
    dilation: Optional[float] = None,
    depth_order: Optional[bool] = None,
    exposure: Optional[bool] = None,
    device: Optional[Device] = None,
    on_progress: Optional[_OnProgress] = None,
) -> dict[str, Any]:
    """Scores a model against a scene's held-out photos, or against another model's pictures: the record of `qirf-vk eval --json`.

    images: the folder of the scene's photos, such as "images_4"; resolution: their size, such as 640 (pixels wide) or "/2". eval_every:
    every eval_every-th photo is held out, 8 by default. background: red, green and blue in [0, 1]. antialias, dilation and depth_order:
    as in Renderer, of both models where there are two; a UserWarning tells of models that are drawn differently. exposure: score with
    exposures fitted to the photos, as runs with that effect do. With a scene these are by default as in the model's run (see Model).

    The record's "test" has the means, "views" the scores of each view: psnr in dB, None where pictures are equal, ssim, and lpips_vgg,
    lpips_vgg_normalized and lpips_alex, which are None without weights ($QIRF_LPIPS: a file or folder made by tools/lpips-weights).
    "ply_bytes" are those of the .ply that the model makes; the record against another model has "schema", "gaussians" with the numbers of
    "model" and "original", "test" and "views".
    """

# Pickles of models and cameras call these.
def _model(
    arrays: tuple[Any, ...],
    antialiased: bool,
    origin: tuple[float, float, float],
    run: dict[str, Any],
    format: Optional[str],
) -> Model: ...
def _camera(k: ArrayLike, world_to_camera: ArrayLike, size: tuple[int, int], near: Optional[float]) -> Camera: ...
