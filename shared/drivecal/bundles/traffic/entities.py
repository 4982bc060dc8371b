"""Entities of an OpenSCENARIO file: vehicles, riders, pedestrians and obstacles, in the file or in a catalog of the bundle."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from posixpath import dirname, join, normpath

from drivecal.bundles.traffic.elements import MOST_ELEMENTS, Element, Notes, declare, named_once, read_tree, substituted
from drivecal.contracts.input_errors import nearest
from drivecal.contracts.strict_json import shown
from drivecal.domain.errors import InvalidInputError

CATEGORIES: Mapping[str, str] = {
    "car": "passenger",
    "van": "delivery",
    "truck": "truck",
    "semitrailer": "trailer",
    "trailer": "trailer",
    "bus": "bus",
    "motorbike": "motorcycle",
    "bicycle": "motorcycle",
}
"""SUMO's class of vehicles by OpenSCENARIO's category."""
ENTITIES = ("Vehicle", "MiscObject", "Pedestrian")
LONGEST = 50.0
"""Metres of a vehicle."""
MOST_ENTITIES = 200


class Files:
    """The files of a bundle. `names`: all of them; `read`: returns the content of one."""

    def __init__(self, names: frozenset[str], read: Callable[[str], bytes]) -> None:
        self.names, self.read = names, read
        self._catalogs: dict[str, str | None] = {}

    def catalog(self, file: str, name: str) -> Element | None:
        """Returns the catalog of this name in an OpenSCENARIO file, None if the file holds another or none: it is not read again to learn
        that. Raises InvalidInputError."""
        if self._catalogs.get(file, name) != name:
            return None
        content = read_tree(self.read(file), file, "OpenSCENARIO", substituted).optional("Catalog")
        self._catalogs[file] = None if content is None else content.text("name")
        return content if self._catalogs[file] == name else None


@dataclass(frozen=True, slots=True)
class Entity:
    """A vehicle, rider or pedestrian: class, length and width (m), and metres from the point that positions mean to the centre ahead."""

    name: str
    vehicle_class: str
    length: float
    width: float
    centre: float
    element: Element


def bundle_path(file: str, path: str, element: Element) -> str:
    """Returns a path that a file names, as a path of the bundle. Raises InvalidInputError if it leaves the folder."""
    whole = normpath(join(dirname(file), path.replace("\\", "/")))
    if path.startswith("/") or whole.startswith(("..", "/")):
        raise element.fault(f"{shown(path, 200)} leaves the folder of the problem", "copy the file into the folder")
    return whole


def entities_of(root: Element, files: Files, notes: Notes) -> dict[str, Entity]:
    """Returns the entities of a file by name. Raises InvalidInputError."""
    locations = root.optional("CatalogLocations")
    if locations is not None:
        locations.skip()
    listed = root.only("Entities").every("ScenarioObject")
    if len(listed) > MOST_ENTITIES:
        raise listed[MOST_ENTITIES].fault(f"there are more than {MOST_ENTITIES} entities", "leave some out")
    entities: dict[str, Entity] = {}
    names: list[str] = []
    referring: dict[str, list[tuple[str, Element, Element]]] = {}
    """Names, references and entities by catalog: each catalog is read once, and none is kept while the next one is read."""
    for element in listed:
        name = element.text("name")
        if name in names:
            raise element.fault(f"another entity is called {shown(name)}", "rename one")
        names.append(name)
        described = element.only(*ENTITIES, "CatalogReference")
        if described.element == "CatalogReference":
            referring.setdefault(described.text("catalogName"), []).append((name, described, element))
        else:
            declare(described, {})
            entities[name] = _entity(name, described, element, notes)
        for controller in element.every("ObjectController"):
            controller.skip()
            notes.add(controller, "ignored: controllers of the file do not drive")
    for catalog, uses in referring.items():
        file, entries = _catalog(catalog, uses[0][1], locations, files)
        for name, reference, element in uses:
            entities[name] = _entity(name, _entry(file, entries, reference), element, notes)
    return {name: entities[name] for name in names}


def _entity(name: str, described: Element, element: Element, notes: Notes) -> Entity:
    for towed in described.every("Trailer"):
        towed.skip()
        if towed.children:
            notes.add(element, f"{shown(name)} is driven without its trailer")
    kind = CATEGORIES[described.word("vehicleCategory", CATEGORIES, "car")] if described.element == "Vehicle" else "passenger"
    box = described.only("BoundingBox")
    size, centre = box.only("Dimensions"), box.only("Center")
    length, width = (size.number(key, 0.05, LONGEST) for key in ("length", "width"))
    if abs(centre.number("y", -LONGEST, LONGEST, 0.0)) > 1e-3:
        notes.add(centre, f"y of {shown(name)} is ignored: the box is driven with its middle on the entity's place")
    return Entity(name, kind, length, width, centre.number("x", -LONGEST, LONGEST), element)


class Catalogs:
    """Catalogs of maneuvers, trajectories and routes; each is read once."""

    def __init__(self, root: Element, files: Files) -> None:
        self._root, self._files = root, files
        self._known: dict[tuple[str, str], tuple[str, dict[str, Element]]] = {}
        self._taken = 0
        """Elements of the entries so far."""

    def entry(self, reference: Element, tag: str) -> Element:
        """Returns the entry of a catalog that a reference names, e.g. a <Maneuver>. Raises InvalidInputError."""
        name = reference.text("catalogName")
        if (name, tag) not in self._known:
            self._known[name, tag] = _catalog(name, reference, self._root.optional("CatalogLocations"), self._files, (tag,))
        taken = _entry(*self._known[name, tag], reference)
        self._taken += _size(taken)
        if self._taken > MOST_ELEMENTS:
            raise reference.fault(
                f"the entries of catalogs have more than {MOST_ELEMENTS:,} elements", "name fewer or smaller ones"
            )
        return taken


def _size(element: Element) -> int:
    return 1 + sum(map(_size, element.children))


def _catalog(
    name: str, reference: Element, locations: Element | None, files: Files, tags: tuple[str, ...] = ENTITIES
) -> tuple[str, dict[str, Element]]:
    """Returns a catalog's file, and its entries by name. Raises InvalidInputError if the bundle does not have it."""
    folders: list[str] = []
    given = [] if locations is None else locations.every(*(f"{tag}Catalog" for tag in tags))
    if len({location.element for location in given}) < len(given):
        raise given[-1].fault("there are several locations of a kind", "give one")
    for location in given:
        directory = location.only("Directory")
        folders.append(directory.text("path"))
        folder = normpath(join(dirname(reference.file), directory.text("path").replace("\\", "/")))
        for file in sorted(
            path for path in files.names if normpath(dirname(path)) == folder and path.lower().endswith(".xosc")
        ):
            content = files.catalog(file, name)
            if content is not None:
                return file, named_once((element.text("name"), element) for element in content.every(*tags))
    place = f" in {', '.join(shown(folder, 100) for folder in folders)}" if folders else ""
    message = f"the bundle has no catalog {shown(name)}{place}"
    raise reference.fault(message, f"copy its .xosc file there, or write a <{tags[0]}> into the file")


def _entry(file: str, entries: Mapping[str, Element], reference: Element) -> Element:
    """Returns the entry of a catalog that a reference names, with the values that it gives. Raises InvalidInputError."""
    name = reference.text("entryName")
    if name not in entries:
        raise reference.fault(f"the catalog {shown(file, 200)} has no entry {shown(name)}", nearest(name, list(entries)))
    own = entries[name].copy()  # other references may give its parameters other values
    _declare(own, reference)
    return own


def _declare(described: Element, reference: Element) -> None:
    """Takes the declarations of a catalog's entry with the values that a reference assigns. Raises InvalidInputError."""
    section = reference.optional("ParameterAssignments")
    assignments = section.every("ParameterAssignment") if section is not None else []
    values = {assignment.parameter("parameterRef"): assignment.text("value") for assignment in assignments}
    try:
        declare(described, values)
    except InvalidInputError as error:
        problem = error.problems[0]
        raise reference.fault(f"{problem.field.removeprefix('parameters.')}: {problem.message}", problem.remedy) from error
