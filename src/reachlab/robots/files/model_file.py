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

from reachlab.robots.files.gripper import GRIPPERS, OwnGripper, fit, mount
from reachlab.robots.files.mesh_search import Folders
from reachlab.robots.files.mjcf import rewrite_mjcf
from reachlab.robots.files.picture_files import MESHES, MISSING, MOST_MESH, PictureFiles, some
from reachlab.robots.files.pictures import as_shells, hide_doubles, leave_out, without_pictures
from reachlab.robots.files.repair import repair
from reachlab.robots.files.safe_xml import MOST_NESTING, XmlFiles
from reachlab.robots.files.urdf import JointFacts, rewrite_urdf
from reachlab.settings.reading import read_regular
from reachlab.settings.validation import InputError, choose

logger = logging.getLogger(__name__)

REFUSALS = (ValueError, mujoco.FatalError, MemoryError)
"""What MuJoCo raises for a model that it refuses."""

MOST_TRIED = 100
"""Up to so many meshes and textures are tried one by one where MuJoCo refuses one of them."""

MOST_BODIES, LARGEST_MASS, FARTHEST = 2000, 1e6, 1000.0
"""Largest number of bodies, and largest mass of one [kg]."""

LONGEST = 30.0
"""Length of a mesh from which on it is said, since it seems to be in millimetres [m]."""

IN_MILLIMETRES = 'are its vertices in millimetres? A URDF\'s <mesh> has scale="0.001 0.001 0.001" for them'
"""What is asked where a shape is huge."""

Stamp = dict[Path, tuple[int, int, int]]
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
        pictures: paths of meshes and textures, by the name under which MuJoCo gets them.
        stamp: of the files that were read.
        repaired: whether masses and inertias that MuJoCo refuses are replaced.
        mounted: a gripper and the frame at which it is mounted, see `reachlab.robots.files.gripper`.
        own: its own gripper, where it is used.
    """

    file: Path
    joints: Mapping[str, JointFacts]
    notices: tuple[str, ...]
    kind: str
    digest: str
    text: str
    pictures: Mapping[str, Path]
    stamp: Stamp
    repaired: bool = False
    mounted: tuple[str, str] | None = None
    own: OwnGripper | None = None

    def spec(self, *, pictures: bool = True) -> mujoco.MjSpec:
        """A fresh specification of the robot, which compiles.

        Args:
            pictures: with meshes, textures and height fields; otherwise only with meshes that give a body its inertia.

        Raises:
            InputError: MuJoCo refuses it.
        """
        return self._parsed(self._broken if pictures else frozenset(), pictures=pictures)

    def _parsed(self, without: frozenset[str], *, pictures: bool) -> mujoco.MjSpec:
        """The same without what is drawn of some files; it may not compile."""
        try:
            spec = mujoco.MjSpec.from_string(self.text)
        except REFUSALS as error:
            raise InputError(_why(error)) from None
        if len(spec.bodies) > MOST_BODIES:
            raise InputError(f"has {len(spec.bodies):,} bodies; at most {MOST_BODIES:,} are read.")
        leave_out(spec, without | {MISSING})
        if self.kind == "URDF":
            as_shells(spec)
            hide_doubles(spec)
        if not pictures:
            without_pictures(spec)
        if self.repaired:
            repair(spec)
        if self.mounted:
            mount(spec, *self.mounted)
        if self.own:
            fit(spec, self.own)
        named = {shape.file for shape in (*spec.meshes, *spec.hfields)}
        named |= {name for texture in spec.textures for name in (texture.file, *texture.cubefiles)}
        spec.assets = {name: _content(self.pictures[name]) for name in named if name in self.pictures}
        return spec

    @functools.cached_property
    def _broken(self) -> frozenset[str]:
        """Names of the meshes and textures that MuJoCo does not read although they are there."""
        if self._error(frozenset()) is None:
            return frozenset()
        every = frozenset(self.pictures)
        one_by_one = every if len(every) <= MOST_TRIED else frozenset()
        refused = {name: error for name in sorted(one_by_one) if (error := self._error(every - {name}))}
        broken = frozenset(refused) or every
        if error := self._error(broken):
            raise InputError(f"robot file {str(self.file)!r} {_why(error)}")
        why = [f"{name} ({_said(error).removeprefix('Error: ')})" for name, error in refused.items()]
        _warn(f"Robot file {self.file}: MuJoCo does not read {some(why or sorted(broken))}: not drawn.")
        return broken

    def _error(self, without: frozenset[str]) -> BaseException | None:
        """What MuJoCo says of the robot without some of its meshes and textures."""
        try:
            model = _compile(self._parsed(without, pictures=True))
        except REFUSALS as error:
            return error
        meshes = np.flatnonzero(model.geom_type == int(mujoco.mjtGeom.mjGEOM_MESH))
        lengths = 2 * model.geom_aabb[meshes, 3:].max(axis=1, initial=0.0)
        if huge := {model.body(model.geom_bodyid[meshes[i]]).name: None for i in np.flatnonzero(lengths > LONGEST)}:
            _warn(f"Robot file {self.file}: a mesh of {some(huge)} is {lengths.max():.3g} m long: {IN_MILLIMETRES}.")
        return None


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
    if known is None or known.stamp != _stamp(known.stamp):
        try:
            known = _READ[asked] = _checked(_read(file, packages or {}))
        except InputError as error:
            raise InputError(f"robot file {str(file)!r} {error}") from None
    return known


@functools.cache
def with_gripper(file: ModelFile, gripper: str, frame: str) -> ModelFile:
    """A model file with a gripper at one of its frames, a site or a body whose z points away from the arm.

    Raises:
        InputError: there is no such gripper.
    """
    choose("gripper", gripper, (*GRIPPERS, "own"))
    return dataclasses.replace(file, digest=f"{file.digest}+{gripper}@{frame}", mounted=(gripper, frame))


@functools.cache
def with_own_gripper(file: ModelFile, own: OwnGripper) -> ModelFile:
    """A model file with the grasp frame and the pads of its own gripper."""
    return dataclasses.replace(file, digest=f"{file.digest}+{own}", own=own)


_READ: dict[tuple[Path, tuple[tuple[str, Path], ...]], ModelFile] = {}
"""Model files that this process has read, by path and packages."""


@functools.cache
def _warn(sentence: str) -> None:
    logger.warning(sentence)


def _stamp(files: Iterable[Path]) -> Stamp | None:
    """What tells that files have changed, without reading them; None where one is gone."""
    try:
        found = {file: file.stat() for file in files}
    except OSError:
        return None
    return {file: (status.st_size, status.st_mtime_ns, status.st_ctime_ns) for file, status in found.items()}


def _read(file: Path, packages: Mapping[str, Path]) -> ModelFile:
    folders = Folders(file, packages)
    texts, pictures = XmlFiles(file, folders.find), PictureFiles(folders)
    root = texts.root()
    joints: dict[str, JointFacts] = {}
    notices: list[str] = []
    if root.tag == "robot":
        text, joints, notices = rewrite_urdf(root, pictures)
    else:
        text = rewrite_mjcf(root, texts, pictures)
    for name, path in pictures.files.items():
        if Path(name).suffix in MESHES:  # the arm does not depend on textures
            texts.hash.update(name.encode() + _content(path))
    return ModelFile(
        file=file,
        joints=joints,
        notices=(*notices, *pictures.notice()),
        kind="URDF" if root.tag == "robot" else "MJCF",
        digest=texts.hash.hexdigest(),
        text=text,
        pictures=pictures.files,
        stamp=_stamp((*texts.files, *pictures.files.values())) or {},
    )


def _content(picture: Path) -> bytes:
    try:
        return read_regular(picture, MOST_MESH)[0]
    except OSError as error:
        raise InputError(f"file {str(picture)!r} cannot be read any more: {error}.") from None


def _checked(model: ModelFile) -> ModelFile:
    """The model once MuJoCo compiles it without pictures, with masses and inertias repaired where it refuses them."""
    try:
        compiled = _compile(model.spec(pictures=False))
    except InputError:
        raise
    except REFUSALS as error:
        changes = [] if model.repaired else repair(model._parsed(frozenset(), pictures=False))
        if not changes:
            raise InputError(_why(error)) from None
        return _checked(dataclasses.replace(model, repaired=True, notices=(*model.notices, *changes)))
    depth = np.zeros(compiled.nbody, int)
    for body in range(1, compiled.nbody):
        depth[body] = depth[compiled.body_parentid[body]] + 1
    heavy = not ((np.abs(compiled.body_pos) <= FARTHEST).all() and (compiled.body_mass <= LARGEST_MASS).all())
    if heavy or depth.max() > MOST_NESTING:
        raise InputError(
            f"has a body that weighs more than {LARGEST_MASS:g} kg, lies more than {FARTHEST:g} m from what holds it,"
            f" or is held by more than {MOST_NESTING} others."
        )
    taken = np.stack([compiled.dof_damping, compiled.dof_frictionloss, compiled.dof_armature])
    for dof in np.flatnonzero((taken < 0).any(axis=0)):
        name = compiled.joint(compiled.dof_jntid[dof]).name
        raise InputError(f"gives joint {name!r} a negative damping, friction or armature: leave its sign out.")
    return model


def _compile(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """The compiled model; MuJoCo's warnings on texture coordinates concern nobody here."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return spec.compile()


def _why(error: BaseException) -> str:
    return f"does not compile: {_said(error)}."


def _said(error: BaseException) -> str:
    return " ".join(str(error).split()).rstrip(".")
