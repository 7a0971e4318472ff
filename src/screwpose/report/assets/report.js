// What the page does by itself: choose combination and stage, toggle layers, zoom, copy, and hand scenes to the 3D view.
// The state stands in the address's #, so that a view of the report can be sent as a link.
(() => {
  "use strict";
  const all = (selector, root = document) => [...root.querySelectorAll(selector)];
  const one = (selector, root = document) => root.querySelector(selector);
  const overlays = one("#overlays");
  const pictures = all("svg.xray");
  const state = new URLSearchParams(location.hash.slice(1));
  let viewer = null;
  let started = false;

  function remember(name, value) {
    if (!started) return; // the address changes when the reader changes something, not before
    if (value) state.set(name, value); else state.delete(name);
    history.replaceState(null, "", `#${state}`);
  }

  // --- combination and stage -------------------------------------------------------------------------------------
  const combination = one("#combination");
  const stages = all("input[name=stage]");
  const available = new Set(all("[data-scene]").map((element) => element.dataset.scene));

  function showScene() {
    if (!combination) return;
    const number = combination.value;
    stages.forEach((stage) => { stage.disabled = !available.has(`${number}-${stage.value}`); });
    let stage = stages.find((input) => input.checked);
    if (!stage || stage.disabled) {
      stage = stages.find((input) => !input.disabled) || stages[0];
      stage.checked = true;
    }
    const key = `${number}-${stage.value}`;
    all("[data-scene]").forEach((element) => element.toggleAttribute("hidden", element.dataset.scene !== key));
    if (viewer) viewer.show(key);
    remember("combination", number);
    remember("stage", stage.value);
  }

  // --- layers ----------------------------------------------------------------------------------------------------
  function showLayers() {
    const boxes = all("input[data-layer]");
    boxes.forEach((box) => overlays.classList.toggle(`hide-${box.dataset.layer}`, !box.checked));
    remember("hide", boxes.filter((box) => !box.checked).map((box) => box.dataset.layer).join(","));
  }

  // --- zoom: the view box moves, marks and lines keep their size on the screen ---------------------------------------
  const boxOf = (text) => text.split(" ").map(Number);

  function setBox(svg, box) {
    svg.setAttribute("viewBox", box.map((value) => value.toFixed(2)).join(" "));
    const { width, height } = svg.getBoundingClientRect();
    if (width) svg.style.setProperty("--px", String(Math.max(box[2] / width, box[3] / height)));
  }

  function frame(svg, whole) {
    setBox(svg, boxOf(whole ? svg.dataset.whole : svg.dataset.crop));
    requestAnimationFrame(() => setBox(svg, boxOf(svg.getAttribute("viewBox")))); // once the new shape is laid out
  }

  function zoom(svg, factor, at) {
    const [left, top, width, height] = boxOf(svg.getAttribute("viewBox"));
    const [u, v] = at || [left + width / 2, top + height / 2];
    setBox(svg, [u - (u - left) * factor, v - (v - top) * factor, width * factor, height * factor]);
  }

  function pixelUnder(svg, event) {
    const point = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
    return [point.x, point.y];
  }

  for (const svg of pictures) {
    svg.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.metaKey) return; // the plain wheel scrolls the page
      event.preventDefault();
      zoom(svg, event.deltaY > 0 ? 1.15 : 1 / 1.15, pixelUnder(svg, event));
    }, { passive: false });
    let grip = null;
    svg.addEventListener("pointerdown", (event) => {
      if (event.pointerType === "touch" || event.button !== 0) return; // a finger scrolls the page
      grip = pixelUnder(svg, event);
      svg.setPointerCapture(event.pointerId);
      svg.classList.add("dragging");
    });
    svg.addEventListener("pointermove", (event) => {
      if (!grip) return;
      const [u, v] = pixelUnder(svg, event);
      const [left, top, width, height] = boxOf(svg.getAttribute("viewBox"));
      setBox(svg, [left + grip[0] - u, top + grip[1] - v, width, height]);
    });
    const release = () => { grip = null; svg.classList.remove("dragging"); };
    svg.addEventListener("pointerup", release);
    svg.addEventListener("pointercancel", release);
    svg.addEventListener("keydown", (event) => {
      const [left, top, width, height] = boxOf(svg.getAttribute("viewBox"));
      const moves = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] };
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      if (event.key === "+" || event.key === "=") zoom(svg, 1 / 1.25);
      else if (event.key === "-") zoom(svg, 1.25);
      else if (moves[event.key]) setBox(svg, [left + moves[event.key][0] * width, top + moves[event.key][1] * height, width, height]);
      else return;
      event.preventDefault();
    });
  }

  const zooms = {
    "in": () => pictures.forEach((svg) => zoom(svg, 1 / 1.3)),
    "out": () => pictures.forEach((svg) => zoom(svg, 1.3)),
    "screws": () => { pictures.forEach((svg) => frame(svg, false)); remember("zoom", ""); },
    "whole": () => { pictures.forEach((svg) => frame(svg, true)); remember("zoom", "whole"); },
  };
  all("button[data-zoom]").forEach((button) => button.addEventListener("click", zooms[button.dataset.zoom]));

  // --- copy ------------------------------------------------------------------------------------------------------
  async function copy(button) {
    const text = one(`#${button.dataset.copy}`).textContent;
    try {
      await navigator.clipboard.writeText(text);
    } catch {
      const field = document.createElement("textarea"); // pages opened from a file may have no clipboard
      field.value = text;
      document.body.append(field);
      field.select();
      document.execCommand("copy");
      field.remove();
    }
    const name = button.textContent;
    button.textContent = "Copied";
    setTimeout(() => { button.textContent = name; }, 1500);
  }
  all("button[data-copy]").forEach((button) => button.addEventListener("click", () => copy(button)));

  // --- 3D --------------------------------------------------------------------------------------------------------
  function mountViewer() {
    const holder = one("#space");
    if (!holder) return;
    const data = JSON.parse(one("#space-data").textContent);
    data.views.forEach((view, index) => { view.image = one("image", pictures[index]).getAttribute("href"); });
    holder.hidden = false;
    try {
      viewer = ScrewposeViewer.mount(holder, data);
    } catch (error) {
      console.warn(error);
      holder.hidden = true;
      holder.dataset.state = "failed";
      one("#no-webgl").hidden = false;
      return;
    }
    one("#still").hidden = true;
    one("#space-controls").hidden = false;
    all("input[data-space]").forEach((box) => {
      const update = () => viewer.setLayer(box.dataset.space, box.checked);
      box.addEventListener("change", update);
      update();
    });
    const step = Math.PI / 12;
    const acts = {
      reset: () => viewer.reset(), left: () => viewer.turn(-step, 0), right: () => viewer.turn(step, 0),
      up: () => viewer.turn(0, step), down: () => viewer.turn(0, -step), nearer: () => viewer.zoom(0.8), farther: () => viewer.zoom(1.25),
    };
    all("button[data-act]").forEach((button) => button.addEventListener("click", acts[button.dataset.act]));
    all("button[data-from]").forEach((button) => button.addEventListener("click", () => viewer.seenFrom(Number(button.dataset.from))));
    const from = Number(state.get("from")) - 1;
    if (data.views[from]) viewer.seenFrom(from);
  }

  // --- start -----------------------------------------------------------------------------------------------------
  if (combination) {
    if (all("option", combination).some((option) => option.value === state.get("combination"))) combination.value = state.get("combination");
    stages.forEach((stage) => { if (stage.value === state.get("stage")) stage.checked = true; });
    combination.addEventListener("change", showScene);
    stages.forEach((stage) => stage.addEventListener("change", showScene));
  }
  if (overlays) {
    const hidden = (state.get("hide") || "").split(",");
    all("input[data-layer]").forEach((box) => {
      if (state.has("hide")) box.checked = !hidden.includes(box.dataset.layer);
      box.addEventListener("change", showLayers);
    });
    all("input[data-opacity]").forEach((slider) => {
      const update = () => overlays.style.setProperty(`--${slider.dataset.opacity}-opacity`, String(slider.value / 100));
      slider.addEventListener("input", update);
      update();
    });
    showLayers();
    new ResizeObserver(() => pictures.forEach((svg) => setBox(svg, boxOf(svg.getAttribute("viewBox"))))).observe(overlays);
    pictures.forEach((svg) => frame(svg, state.get("zoom") === "whole"));
  }
  mountViewer();
  showScene();
  started = true;
  document.documentElement.dataset.ready = "yes";
})();
