"""Entities of an OpenSCENARIO file: vehicles, and obstacles that stand still, in the file or in a catalog of the bundle."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from posixpath import dirname, join, normpath

from drivecal.bundles.traffic.elements import Element, Notes, read_tree
from drivecal.bundles.traffic.parameters import declare, substituted
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
}
"""SUMO's class of vehicles by OpenSCENARIO's category."""
LONGEST = 50.0
"""Metres of a vehicle."""


class Files:
    """The files of a bundle. `names`: all of them; `read`: returns the content of one."""

    def __init__(self, names: frozenset[str], read: Callable[[str], bytes]) -> None:
        self.names, self.read = names, read


@dataclass(frozen=True, slots=True)
class Entity:
    """A vehicle: class, length and width (m), and how far the centre lies ahead of the point that positions mean (m).

    `is_still`: a pedestrian, which can only be an obstacle.
    """

    name: str
    vehicle_class: str
    length: float
    width: float
    centre: float
    is_still: bool
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
    entities: dict[str, Entity] = {}
    for element in root.only("Entities").every("ScenarioObject"):
        name = element.text("name")
        if name in entities:
            raise element.fault(f"another entity is called {shown(name)}", "rename one")
        described = element.only("Vehicle", "MiscObject", "Pedestrian", "CatalogReference")
        if described.element == "CatalogReference":
            described = _from_catalog(described, locations, files)
        entities[name] = _entity(name, described, element)
        if (controller := element.optional("ObjectController")) is not None:
            controller.skip()
            notes.add(controller, "ignored: controllers of the file do not drive")
    return entities


def _entity(name: str, described: Element, element: Element) -> Entity:
    vehicle_class = (
        CATEGORIES[described.word("vehicleCategory", CATEGORIES, "car")] if described.element == "Vehicle" else "passenger"
    )
    box = described.only("BoundingBox")
    size, centre = box.only("Dimensions"), box.only("Center")
    length, width = (size.number(key, 0.05, LONGEST) for key in ("length", "width"))
    is_still = described.element == "Pedestrian"
    return Entity(name, vehicle_class, length, width, centre.number("x", -LONGEST, LONGEST), is_still, element)


def _from_catalog(reference: Element, locations: Element | None, files: Files) -> Element:
    """Returns the vehicle of a catalog that a reference names. Raises InvalidInputError if the bundle does not have it."""
    catalog, entry = reference.text("catalogName"), reference.text("entryName")
    folders = []
    for location in (
        locations.every("VehicleCatalog", "MiscObjectCatalog", "PedestrianCatalog") if locations is not None else []
    ):
        directory = location.only("Directory")
        folders.append(directory.text("path"))
        folder = normpath(join(dirname(reference.file), directory.text("path")))
        for file in sorted(name for name in files.names if dirname(name) == folder and name.endswith(".xosc")):
            root = read_tree(files.read(file), file, "OpenSCENARIO", substituted)
            content = root.optional("Catalog")
            if content is None or content.text("name") != catalog:
                continue
            described = content.every("Vehicle", "MiscObject", "Pedestrian")
            for element in described:
                if element.text("name") == entry:
                    _declare(element, reference)
                    return element
            remedy = nearest(entry, [element.text("name") for element in described])
            raise reference.fault(f"the catalog {shown(file, 200)} has no entry {shown(entry)}", remedy)
    place = f" in {', '.join(shown(folder, 100) for folder in folders)}" if folders else ""
    message = f"the bundle has no catalog {shown(catalog)}{place}"
    raise reference.fault(message, "copy its .xosc file there, or write a <Vehicle> into the file")


def _declare(described: Element, reference: Element) -> None:
    """Takes the declarations of a catalog's entry with the values that a reference assigns. Raises InvalidInputError."""
    section = reference.optional("ParameterAssignments")
    assignments = section.every("ParameterAssignment") if section is not None else []
    values = {assignment.text("parameterRef").removeprefix("$"): assignment.text("value") for assignment in assignments}
    try:
        declare(described, values)
    except InvalidInputError as error:
        problem = error.problems[0]
        raise reference.fault(f"{problem.field.removeprefix('parameters.')}: {problem.message}", problem.remedy) from error
