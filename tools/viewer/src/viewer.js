// The 3D view of report.html: placed implants, image planes and X-ray sources in the world frame, mm.
// It draws what Python computed: positions, matrices and colours arrive in the data, nothing is estimated here.
import {
  AmbientLight, ArrowHelper, BufferAttribute, BufferGeometry, CanvasTexture, Color, DirectionalLight, DoubleSide, Group,
  LineBasicMaterial, LineSegments, Matrix4, Mesh, MeshBasicMaterial, MeshPhongMaterial, PerspectiveCamera, Quaternion,
  Scene, SphereGeometry, Sprite, SpriteMaterial, SRGBColorSpace, Texture, Vector3, WebGLRenderer,
} from "three";
import { TrackballControls } from "three/addons/controls/TrackballControls.js";

const FIELD_OF_VIEW_DEG = 30;
const vector = (numbers) => new Vector3(...numbers);

function bytes(base64) {
  return Uint8Array.from(atob(base64), (character) => character.charCodeAt(0)).buffer;
}

function meshGeometry(model) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(bytes(model.vertices)), 3));
  geometry.setIndex(new BufferAttribute(new Uint32Array(bytes(model.faces)), 1));
  geometry.computeVertexNormals(); // unused by flat shading, wanted by the material
  return geometry;
}

function lines(pairs, color, opacity = 1) {
  const geometry = new BufferGeometry().setFromPoints(pairs.flat().map(vector));
  const material = new LineBasicMaterial({ color, transparent: opacity < 1, opacity });
  return new LineSegments(geometry, material);
}

// Text is painted on a canvas, so that a label can never become markup.
function textSprite(text, color, heightMm) {
  const canvas = document.createElement("canvas");
  const context = canvas.getContext("2d");
  const font = "600 44px system-ui, sans-serif";
  context.font = font;
  canvas.width = Math.ceil(context.measureText(text).width) + 24;
  canvas.height = 64;
  context.font = font;
  context.textBaseline = "middle";
  context.lineWidth = 8;
  context.lineJoin = "round";
  context.strokeStyle = "rgba(0,0,0,0.75)";
  context.strokeText(text, 12, 32);
  context.fillStyle = color;
  context.fillText(text, 12, 32);
  const texture = new CanvasTexture(canvas);
  texture.colorSpace = SRGBColorSpace;
  const sprite = new Sprite(new SpriteMaterial({ map: texture, depthTest: false, transparent: true }));
  sprite.scale.set((heightMm * canvas.width) / canvas.height, heightMm, 1);
  sprite.renderOrder = 10;
  return sprite;
}

function imagePlane(view, redraw) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(view.corners.flat()), 3));
  geometry.setAttribute("uv", new BufferAttribute(new Float32Array(view.texture.flat()), 2));
  geometry.setIndex([0, 2, 1, 0, 3, 2]);
  const texture = new Texture();
  texture.colorSpace = SRGBColorSpace;
  const image = new Image();
  image.onload = () => { texture.image = image; texture.needsUpdate = true; redraw(); };
  image.src = view.image;
  return new Mesh(geometry, new MeshBasicMaterial({ map: texture, side: DoubleSide }));
}

function sourceAndFrustum(view, labelHeightMm) {
  const group = new Group();
  const source = new Mesh(new SphereGeometry(labelHeightMm * 0.6, 24, 16), new MeshBasicMaterial({ color: 0xd9a400 }));
  source.position.copy(vector(view.source));
  group.add(source, lines(view.corners.map((corner) => [view.source, corner]), 0xd9a400, 0.6));
  const label = textSprite(`${view.name} source`, "#ffd24d", labelHeightMm * 2);
  label.position.copy(vector(view.source));
  group.add(label);
  return group;
}

function worldAxes(origin, length) {
  const group = new Group();
  [["x", 0xe0603a, [1, 0, 0]], ["y", 0x2ca25f, [0, 1, 0]], ["z", 0x3f8fd8, [0, 0, 1]]].forEach(([name, color, axis]) => {
    group.add(new ArrowHelper(vector(axis), vector(origin), length, color, length * 0.25, length * 0.12));
    const label = textSprite(name, `#${new Color(color).getHexString()}`, length * 0.35);
    label.position.copy(vector(origin)).addScaledVector(vector(axis), length * 1.2);
    group.add(label);
  });
  return group;
}

function implantGroup(item, geometries, labelHeightMm, layers) {
  const group = new Group();
  for (const piece of item.pieces) {
    const material = new MeshPhongMaterial({
      color: item.color, specular: 0x555555, shininess: 40, flatShading: true, side: DoubleSide,
      transparent: item.ghost, opacity: item.ghost ? 0.35 : 1, depthWrite: !item.ghost,
    });
    const mesh = new Mesh(geometries[piece.model], material);
    mesh.applyMatrix4(new Matrix4().set(...piece.matrix));
    group.add(mesh);
  }
  if (item.ghost) return group;
  const axis = lines([item.axis], item.color);
  const tip = new Mesh(new SphereGeometry(labelHeightMm * 0.12, 12, 8), new MeshBasicMaterial({ color: item.color }));
  tip.position.copy(vector(item.tip));
  const label = textSprite(item.name, item.color, labelHeightMm);
  label.position.copy(vector(item.axis[1]));
  label.center.set(-0.04, 0.5); // beside the line's end, not across it
  layers.axes.push(axis, tip);
  layers.labels.push(label);
  group.add(axis, tip, label);
  return group;
}

/**
 * Draw into an element. Throws where there is no WebGL: the page then keeps its still picture.
 * data: {models, scenes: {key: [item]}, truth: [item], views, focus: {center, radius}, axes_origin, up, direction}
 */
export function mount(element, data) {
  const renderer = new WebGLRenderer({ antialias: true, alpha: true, preserveDrawingBuffer: true });
  renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
  const canvas = renderer.domElement;
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", element.dataset.label || "3D view of the placed screws");
  element.replaceChildren(canvas);

  const { center, radius } = data.focus;
  const target = vector(center);
  const labelHeightMm = radius * 0.09;
  const scene = new Scene();
  const camera = new PerspectiveCamera(FIELD_OF_VIEW_DEG, 1, radius / 100, radius * 100);
  const headlight = new DirectionalLight(0xffffff, 2.2);
  camera.add(headlight);
  headlight.position.set(0.4, 0.7, 1);
  scene.add(camera, new AmbientLight(0xffffff, 1.1));

  const layers = { planes: [], sources: [], axes: [], labels: [], world: [], truth: [] };
  const shown = { planes: true, sources: false, axes: true, labels: true, world: true, truth: true };
  let dirty = true;
  const redraw = () => { dirty = true; };

  const geometries = Object.fromEntries(Object.entries(data.models).map(([key, model]) => [key, meshGeometry(model)]));
  const scenes = {};
  for (const [key, items] of Object.entries(data.scenes)) {
    scenes[key] = new Group();
    items.forEach((item) => scenes[key].add(implantGroup(item, geometries, labelHeightMm, layers)));
    scene.add(scenes[key]);
  }
  data.truth.forEach((item) => layers.truth.push(implantGroup(item, geometries, labelHeightMm, layers)));
  data.views.forEach((view) => {
    layers.planes.push(imagePlane(view, redraw));
    layers.sources.push(sourceAndFrustum(view, labelHeightMm));
  });
  layers.world.push(worldAxes(data.axes_origin, radius * 0.3));
  [layers.planes, layers.sources, layers.world, layers.truth].flat().forEach((object) => scene.add(object));

  const controls = new TrackballControls(camera, canvas);
  controls.staticMoving = true;
  controls.rotateSpeed = 2.5;
  controls.zoomSpeed = 1.0;
  controls.panSpeed = 0.5;
  controls.keys = ["", "", ""];
  controls.minDistance = radius * 0.2;
  controls.maxDistance = radius * 60;
  controls.noZoom = true; // until the view is clicked, the wheel scrolls the page
  controls.addEventListener("change", redraw);
  canvas.addEventListener("focus", () => { controls.noZoom = false; });
  canvas.addEventListener("blur", () => { controls.noZoom = true; });
  canvas.addEventListener("pointerdown", () => canvas.focus({ preventScroll: true }));

  let framing = reset; // repeated when the element changes its shape, until the reader moves the view
  controls.addEventListener("start", () => { framing = null; });

  function lookFrom(position, up) {
    controls.target.copy(target);
    camera.position.copy(position);
    camera.up.copy(vector(up)).normalize();
    camera.lookAt(target);
    controls.update();
    redraw();
  }

  function reset() {
    framing = reset;
    camera.fov = FIELD_OF_VIEW_DEG;
    camera.updateProjectionMatrix();
    const half = (FIELD_OF_VIEW_DEG * Math.PI) / 360;
    const fit = (radius * 1.15) / Math.sin(half) / Math.min(1, camera.aspect);
    lookFrom(target.clone().addScaledVector(vector(data.direction), fit), data.up);
  }

  // From the source itself the implants cover their own shadows: the eye sees how well a pose fits.
  function seenFrom(index) {
    framing = () => seenFrom(index);
    const view = data.views[index];
    const source = vector(view.source);
    const half = Math.asin(Math.min(0.9, radius / source.distanceTo(target)));
    camera.fov = (2 * Math.atan(Math.tan(half * 1.1) / Math.min(1, camera.aspect)) * 180) / Math.PI;
    camera.updateProjectionMatrix();
    lookFrom(source, view.up);
  }

  function turn(rightRad, upRad) {
    framing = null;
    const offset = camera.position.clone().sub(controls.target);
    const sideways = new Vector3().crossVectors(camera.up, offset).normalize();
    const rotation = new Quaternion().setFromAxisAngle(camera.up.clone().normalize(), rightRad)
      .multiply(new Quaternion().setFromAxisAngle(sideways, -upRad));
    offset.applyQuaternion(rotation);
    camera.up.applyQuaternion(rotation).normalize();
    camera.position.copy(controls.target).add(offset);
    camera.lookAt(controls.target);
    redraw();
  }

  function zoom(factor) {
    framing = null;
    camera.position.sub(controls.target).multiplyScalar(factor).add(controls.target);
    redraw();
  }

  const step = Math.PI / 24;
  const actions = {
    ArrowLeft: () => turn(-step, 0), ArrowRight: () => turn(step, 0), ArrowUp: () => turn(0, step),
    ArrowDown: () => turn(0, -step), "+": () => zoom(0.85), "=": () => zoom(0.85), "-": () => zoom(1 / 0.85), r: reset, Home: reset,
  };
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const index = Number(event.key) - 1;
    const action = actions[event.key] || (data.views[index] && (() => seenFrom(index)));
    if (!action) return;
    event.preventDefault();
    action();
  });

  function setLayer(name, visible) {
    shown[name] = visible;
    layers[name].forEach((object) => { object.visible = visible; });
    redraw();
  }

  function show(key) {
    Object.entries(scenes).forEach(([name, group]) => { group.visible = name === key; });
    redraw();
  }

  function resize() {
    const width = element.clientWidth;
    const height = element.clientHeight;
    if (!width || !height) return;
    renderer.setSize(width, height, false);
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
    controls.handleResize();
    if (framing) framing();
    redraw();
  }

  new ResizeObserver(resize).observe(element);
  resize();
  Object.entries(shown).forEach(([name, visible]) => setLayer(name, visible));
  renderer.setAnimationLoop(() => {
    controls.update();
    if (!dirty) return;
    dirty = false;
    renderer.render(scene, camera);
    element.dataset.state = "ready";
  });
  return { show, setLayer, reset, seenFrom, turn, zoom };
}
