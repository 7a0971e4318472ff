"""An X-ray on the page: the Python side of static/xray.js."""

import json
from typing import Any

from nicegui import ui


class Viewer(ui.element, component="static/xray.js"):
    """Shows one X-ray and what lies over it, and tells what a hand does: `placed`, `moved`, `selected`, `picked`,
    `nudged`, `turned`, `painted`, `entered`, `stepped`, `removed`, `escaped`."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self._props["name"] = name
        self.name = name
        self._is_ready = False
        self._source: dict[str, Any] | None = None
        self._state: dict[str, Any] = {}
        self._sent: dict[str, str] = {}
        self.on("ready", self._begin)

    def show(self, facts: dict[str, Any]) -> None:
        """Show the pixels of a view, by what `looking` found of it."""
        self._source = {
            "url": f"/pixels/{facts['key']}",
            **{key: facts[key] for key in ("key", "width", "height", "window")},
        }
        self._send()

    def set(self, **state: Any) -> None:
        """Change what lies over the X-ray; only what is new goes to the browser."""
        self._state.update(state)
        self._send()

    def _begin(self) -> None:
        self._is_ready, self._sent = True, {}
        self._send()

    def _send(self) -> None:
        if not self._is_ready:
            return
        texts = {key: json.dumps(value) for key, value in self._state.items()}
        changed = {key: self._state[key] for key, text in texts.items() if self._sent.get(key) != text}
        self._sent.update({key: texts[key] for key in changed})
        if changed:
            self.run_method("set", changed)
        if self._source is not None and self._sent.get("source") != self._source["key"]:
            self._sent["source"] = self._source["key"]
            self.run_method("show", self._source)
