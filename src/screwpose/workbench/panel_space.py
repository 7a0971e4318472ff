"""3D: the implants where they were found, and both C-arms with their X-rays."""

from typing import TYPE_CHECKING, Any

import numpy as np
from nicegui import events, ui

from screwpose.workbench.screw_buttons import screw_buttons

if TYPE_CHECKING:
    from screwpose.workbench.page_case import CasePage

_VIEW_AWAY = 4.8  # radii of what is shown, from its middle to the eye
_LINE = "#8aa0b5"
# The camera is the browser's, which a hand turns without the server: so do keys, about the same point.
_KEYS = """(event) => {
    const ways = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }, way = ways[event.key];
    const nearer = { "+": 0.9, "=": 0.9, "-": 1 / 0.9 }[event.key];
    if ((!way && !nearer) || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    const { camera, controls } = getElement(SCENE), eye = camera.position.clone().sub(controls.target);
    const right = camera.up.clone().cross(eye).normalize(), up = eye.clone().cross(right).normalize();
    if (nearer) eye.multiplyScalar(nearer);
    else if (event.shiftKey) {
        controls.target.addScaledVector(way[0] ? right : up, 0.03 * (way[0] + way[1]) * eye.length());
    } else for (const one of [eye, camera.up]) one.applyAxisAngle(way[0] ? up : right, 0.1 * (way[0] - way[1]));
    camera.position.copy(controls.target).add(eye);
}"""


class SpacePanel:
    """The fourth stage."""

    def __init__(self, page: "CasePage") -> None:
        self._page = page
        self._drawn: Any = None
        self._meshes: dict[str, list[Any]] = {}

    def build(self) -> None:
        """Make its elements."""
        self._drawn = None
        self._place = ui.element("div").classes("space")
        self._side = ui.element("aside").classes("side")

    def refresh(self) -> None:
        """Show the result as it is now."""
        session = self._page.session
        data = session.reviewed
        key = (id(data), self._page.theme.is_light)
        if key != self._drawn:
            self._drawn = key
            self._place.clear()
            with self._place:
                if data is None or data["space"] is None:
                    ui.label("Nothing to show yet: solve the case first.").classes("empty")
                else:
                    self._draw(data)
        self._list(data)
        self._light_up(data)

    def _draw(self, data: dict[str, Any]) -> None:
        space = data["space"]
        center, radius = np.array(space["focus"]["center"]), float(space["focus"]["radius"])
        eye = center + _VIEW_AWAY * radius * np.array(space["direction"])
        camera = ui.scene.perspective_camera(fov=40, near=1.0, far=5000.0)
        self._meshes = {}
        with ui.scene(
            width=1200, height=800, grid=False, camera=camera, on_click=self._clicked, click_events=["click"],
            background_color="#dfe4e9" if self._page.theme.is_light else "#0c0f12", control_type="trackball", fps=60,
        ).classes("scene").props('tabindex=0 role="application" aria-label="3D view"') as scene:  # fmt: skip
            scene.on("keydown", js_handler=_KEYS.replace("SCENE", str(scene.id)))
            for item in space["scenes"][space["first"]]:
                meshes = []
                for piece in item["pieces"]:
                    matrix = np.array(piece["matrix"]).reshape(4, 4)
                    mesh = scene.stl(f"/mesh/{space['models'][piece['model']]}").with_name(f"screw:{item['name']}")
                    mesh.rotate_R(matrix[:3, :3].tolist()).move(*matrix[:3, 3].tolist()).material(item["color"])
                    meshes.append(mesh)
                self._meshes[item["name"]] = meshes
                scene.line(*item["axis"]).material(item["color"])
            for view in space["views"]:
                self._carm(scene, view)
        ways = ("", "look_at_", "up_")
        place = {
            f"{way}{axis}": float(value)
            for way, point in zip(ways, (eye, center, space["up"]), strict=True)
            for axis, value in zip("xyz", point, strict=True)
        }
        scene.move_camera(**place, duration=0)

    def _carm(self, scene: ui.scene, view: dict[str, Any]) -> None:
        """A source, the rays to the corners of its image, and the image on their plane."""
        facts = self._page.session.known.get("views", {}).get(view["name"])
        plane = _whole_plane(view)
        source, corners = view["source"], [plane[0][0], plane[0][1], plane[1][1], plane[1][0]]
        for index, corner in enumerate(corners):
            scene.line(source, corner).material(_LINE, opacity=0.35)
            scene.line(corner, corners[(index + 1) % 4]).material(_LINE)
        scene.sphere(4.0).move(*source).material(_LINE)
        color = "#0b6e80" if self._page.theme.is_light else "#8fd3ff"
        scene.text(view["name"], f"color: {color}; font-weight: 600; font-size: 1rem").move(*corners[0])
        if facts is not None:
            scene.texture(f"/preview/{facts['key']}", plane).material("#ffffff", opacity=1.0, side="both").with_name(
                f"view:{view['name']}"
            )

    def _clicked(self, event: events.SceneClickEventArguments) -> None:
        data = self._page.session.reviewed or {"screws": []}
        names = [one["name"] for one in data["screws"]]
        hit = next((one.object_name[6:] for one in event.hits if one.object_name.startswith("screw:")), None)
        if hit in names:
            self._page.choose_screw(names.index(hit))

    def _list(self, data: dict[str, Any] | None) -> None:
        self._side.clear()
        with self._side:
            ui.label(
                "Drag to turn, right button to move, wheel to zoom; by keys: arrows, Shift + arrows, + and -. "
                "Click a screw to choose it everywhere."
            ).classes("muted small")
            screw_buttons(self._page, data["screws"] if data else [], _nothing_beside, _model_and_tip)

    def _light_up(self, data: dict[str, Any] | None) -> None:
        for index, screw in enumerate(data["screws"] if data else ()):
            for mesh in self._meshes.get(screw["name"], []):
                faint = self._page.screw is not None and self._page.screw != index
                mesh.material(screw["color"], opacity=0.35 if faint else 1.0)


def _nothing_beside(_screw: dict[str, Any]) -> None:
    """The name says it all."""


def _model_and_tip(screw: dict[str, Any]) -> None:
    ui.label(f"{screw['model']}, {screw['words']}").classes("small")
    ui.label("Tip " + ", ".join(f"{x:.1f}" for x in screw["tip"]) + " mm").classes("muted small")


def _whole_plane(view: dict[str, Any]) -> Any:
    """The corners of the whole image, row by row, from those of the part that the report shows and its place in it."""
    low_high = np.array(view["texture"])  # the part's corners in the image, from its lower left, 0 to 1
    corners = np.array(view["corners"])
    (u0, v0), (u1, v1) = low_high[0], low_high[2]
    right, down = (corners[1] - corners[0]) / (u1 - u0), (corners[3] - corners[0]) / (v0 - v1)
    top_left = corners[0] - right * u0 - down * (1.0 - v0)
    points = [[top_left, top_left + right], [top_left + down, top_left + right + down]]
    return [[point.tolist() for point in row] for row in points]
