"""Reading of a robot's model file, MJCF or URDF: MuJoCo gets its text and its meshes, and opens no file itself."""

from __future__ import annotations

import dataclasses
import functools
import logging
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from reachlab.robots.mesh_search import Folders
from reachlab.robots.mjcf import rewrite_mjcf
from reachlab.robots.picture_files import MESHES, MOST_MESH, PictureFiles
from reachlab.robots.pictures import leave_out, without_pictures
from reachlab.robots.safe_xml import XmlFiles
from reachlab.robots.urdf import JointFacts, rewrite_urdf, some
from reachlab.settings.reading import read_regular
from reachlab.settings.validation import InputError

__all__ = ["JointFacts", "ModelFile", "read_model_file"]

logger = logging.getLogger(__name__)

REFUSALS = (ValueError, mujoco.FatalError, MemoryError)
"""What MuJoCo raises for a model that it refuses."""

MOST_TRIED = 100
"""Up to so many meshes and textures are tried one by one where MuJoCo refuses one of them."""

LARGEST_MASS = 1e6
"""Largest mass of a body [kg]."""


Stamp = tuple[tuple[Path, int, int, int], ...]
"""Size [bytes] and times of change of files [ns]."""


@dataclass(frozen=True, eq=False)
class ModelFile:
    """A robot's model file, read.

    Attributes:
        file: the file.
        joints: what a URDF says of its joints, by name; empty for MJCF.
        notices: one sentence on each thing that was left out, guessed or changed.
        kind: MJCF or URDF.
        digest: SHA-256 of all that decides the arm: the XML text and the meshes that were read.
        text: XML text that MuJoCo gets.
        parts: XML text of sub-models, by the name under which MuJoCo gets them.
        pictures: paths of meshes and textures, by the name under which MuJoCo gets them.
        stamp: of the files that were read, see `_stamp`.
        balanced: whether MuJoCo replaces inertias that no rigid body has.
    """

    file: Path
    joints: Mapping[str, JointFacts]
    notices: tuple[str, ...]
    kind: str
    digest: str
    text: str
    parts: Mapping[str, bytes]
    pictures: Mapping[str, Path]
    stamp: Stamp
    balanced: bool = False

    def spec(self, *, pictures: bool = True) -> mujoco.MjSpec:
        """A fresh specification of the robot, which compiles.

        Args:
            pictures: with meshes, textures, height fields and skins; otherwise only with meshes that give a body its
                inertia.

        Raises:
            InputError: MuJoCo refuses it.
        """
        spec = self.parsed()
        leave_out(spec, self._broken if pictures else frozenset())
        if not pictures:
            without_pictures(spec)
        named = {shape.file for shape in (*spec.meshes, *spec.hfields)}
        named |= {name for texture in spec.textures for name in (texture.file, *texture.cubefiles)}
        spec.assets = {name: self._bytes(name) for name in named if name in self.pictures}
        return spec

    def parsed(self) -> mujoco.MjSpec:
        """A fresh specification of all that the text says, with the files that are missing."""
        try:
            spec = mujoco.MjSpec.from_string(self.text, include=dict(self.parts))
        except REFUSALS as error:
            raise _refused(self.file, error) from None
        if self.balanced:
            spec.compiler.balanceinertia = True
        if self.kind == "URDF":
            for mesh in spec.meshes:  # no mass comes from them, and those that are not closed have no volume
                mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        return spec

    @functools.cached_property
    def _broken(self) -> frozenset[str]:
        """Names of the meshes and textures that MuJoCo does not read although they are there."""
        if self._error(frozenset()) is None:
            return frozenset()
        every = frozenset(self.pictures)
        one_by_one = every if len(every) <= MOST_TRIED else frozenset()
        broken = frozenset(name for name in one_by_one if self._error(every - {name})) or every
        if error := self._error(broken):
            raise _refused(self.file, error)
        logger.warning("Robot file %s: MuJoCo does not read %s, not drawn.", self.file, some(sorted(broken)))
        return broken

    def _error(self, without: frozenset[str]) -> BaseException | None:
        """What MuJoCo says of the robot without some of its meshes and textures."""
        spec = self.parsed()
        leave_out(spec, without)
        spec.assets = {name: self._bytes(name) for name in self.pictures if name not in without}
        try:
            _compile(spec)
        except REFUSALS as error:
            return error
        return None

    def _bytes(self, name: str) -> bytes:
        return _content(self.pictures[name])


def read_model_file(file: Path, packages: Mapping[str, Path] | None = None) -> ModelFile:
    """A robot's model file, checked: its joints and bodies compile.

    It is the same object until one of the files that were read changes.

    Args:
        file: MJCF or URDF.
        packages: folders of the packages that `package://NAME/...` names, by name.

    Raises:
        InputError: it is missing, no MJCF or URDF, harmful, or MuJoCo refuses it.
    """
    asked = (file.absolute(), tuple(sorted((packages or {}).items())))
    known = _READ.get(asked)
    if known is None or known.stamp != _stamp(path for path, *_ in known.stamp):
        known = _READ[asked] = _read(file, packages or {})
    return known


_READ: dict[tuple[Path, tuple[tuple[str, Path], ...]], ModelFile] = {}
"""Model files that this process has read, by path and packages."""


def _stamp(files: Iterable[Path]) -> Stamp | None:
    """What tells that files have changed, without reading them; None where one is gone."""
    try:
        found = [(file, file.stat()) for file in files]
    except OSError:
        return None
    return tuple((file, status.st_size, status.st_mtime_ns, status.st_ctime_ns) for file, status in found)


def _read(file: Path, packages: Mapping[str, Path]) -> ModelFile:
    folders = Folders(file, packages)
    texts, pictures = XmlFiles(file, folders.find), PictureFiles(folders)
    root = texts.root()
    joints: dict[str, JointFacts] = {}
    parts: dict[str, bytes] = {}
    if root.tag == "robot":
        text, joints, notices = rewrite_urdf(root, pictures)
    else:
        text, parts, notices = rewrite_mjcf(root, texts, pictures)
    kind = "URDF" if root.tag == "robot" else "MJCF"
    stamp = _stamp((*texts.files, *pictures.files.values())) or ()
    digest = _digest(texts, pictures)
    model = ModelFile(file, joints, tuple(notices), kind, digest, text, parts, dict(pictures.files), stamp)
    if light := leave_out(model.parsed(), frozenset()):
        model = _noticed(
            model, f"Moving bodies whose mass came from a mesh that is missing get 0.01 kg: {some(light)}."
        )
    return _checked(model)


def _digest(texts: XmlFiles, pictures: PictureFiles) -> str:
    """SHA-256 of XML text and meshes; not of textures, which the arm does not depend on."""
    whole = texts.hash.copy()
    for name, path in pictures.files.items():
        if Path(name).suffix in MESHES:
            whole.update(name.encode() + _content(path))
    return whole.hexdigest()


def _content(picture: Path) -> bytes:
    try:
        return read_regular(picture, MOST_MESH)[0]
    except OSError as error:
        raise InputError(f"file {str(picture)!r} cannot be read any more: {error}.") from None


def _checked(model: ModelFile) -> ModelFile:
    """The model once MuJoCo compiles it without pictures, with inertias balanced where MuJoCo asks for that."""
    try:
        compiled = _compile(model.spec(pictures=False))
    except REFUSALS as error:
        if "balanceinertia" not in str(error) or model.balanced:
            raise error if isinstance(error, InputError) else _refused(model.file, error) from None
        model = _noticed(model, "Inertias that no rigid body has are replaced by the mean of their moments.")
        return _checked(dataclasses.replace(model, balanced=True))
    if not (np.isfinite(compiled.body_pos).all() and (compiled.body_mass <= LARGEST_MASS).all()):
        raise InputError(
            f"robot file {str(model.file)!r} has a body whose position is not finite or that weighs more than"
            f" {LARGEST_MASS:g} kg."
        )
    return model


def _compile(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """The compiled model; MuJoCo's warnings on texture coordinates concern nobody here."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return spec.compile()


def _noticed(model: ModelFile, notice: str) -> ModelFile:
    return dataclasses.replace(model, notices=(*model.notices, notice))


def _refused(file: Path, error: BaseException) -> InputError:
    why = " ".join(str(error).split()).rstrip(".")
    return InputError(f"robot file {str(file)!r} does not compile: {why}.")
