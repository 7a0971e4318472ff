// One X-ray on the screen: 16-bit pixels windowed by the graphics card, and over them marks, lines and outlines.
// It draws what it is told and tells what a hand does; whatever is geometry is computed by the server.

const VERTEX = `#version 300 es
const vec2 corners[4] = vec2[4](vec2(-1, -1), vec2(1, -1), vec2(-1, 1), vec2(1, 1));
void main() { gl_Position = vec4(corners[gl_VertexID], 0, 1); }`;

// Each screen pixel: where in the image it is (integer pixels are centres), four texels, a straight line between them.
const FRAGMENT = `#version 300 es
precision highp float; precision highp usampler2D;
uniform usampler2D image; uniform vec2 size; uniform vec2 origin; uniform float step_px; uniform float height; uniform vec2 corner;
uniform vec2 bounds; uniform bool inverted; uniform vec3 outside;
out vec4 color;
float at(ivec2 p) { return float(texelFetch(image, clamp(p, ivec2(0), ivec2(size) - 1), 0).r); }
void main() {
  vec2 here = gl_FragCoord.xy - corner;  // the loupe is a part of the canvas, and gl_FragCoord counts from the canvas's
  vec2 p = origin + vec2(here.x - 0.5, height - here.y - 0.5) * step_px;
  if (any(lessThan(p, vec2(-0.5))) || any(greaterThan(p, size - 0.5))) { color = vec4(outside, 1); return; }
  vec2 f = floor(p); ivec2 i = ivec2(f); vec2 t = p - f;
  float v = mix(mix(at(i), at(i + ivec2(1, 0)), t.x), mix(at(i + ivec2(0, 1)), at(i + ivec2(1, 1)), t.x), t.y);
  float g = clamp((v - bounds.x) / max(bounds.y - bounds.x, 1.0), 0.0, 1.0);
  color = vec4(vec3(inverted ? 1.0 - g : g), 1);
}`;

const LOUPE_PX = 190, LOUPE_ZOOM = 6, NEAR_PX = 9, CLICK_PX = 4;
const DASHES = { solid: [], dashed: [9, 5], dotted: [2, 5] };
const clamp = (x, low, high) => Math.min(Math.max(x, low), high);

function compiled(gl, kind, text) {
  const shader = gl.createShader(kind);
  gl.shaderSource(shader, text);
  gl.compileShader(shader);
  if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
  return shader;
}

// Half the size, each pixel the mean of four: what is shown small neither flickers nor has moire.
function halved({ data, width, height }) {
  const w = width >> 1, h = height >> 1, half = new Uint16Array(w * h);
  for (let row = 0; row < h; row++) {
    let a = 2 * row * width, b = a + width;
    for (let column = 0; column < w; column++, a += 2, b += 2)
      half[row * w + column] = (data[a] + data[a + 1] + data[b] + data[b + 1] + 2) >> 2;
  }
  return { data: half, width: w, height: h };
}

export default {
  template: `<div class="xray" @contextmenu.prevent>
    <canvas ref="image" class="xray-image"></canvas>
    <canvas ref="over" class="xray-over" tabindex="0" role="application" :aria-label="label"></canvas>
    <div class="xray-name">{{ name }}<span class="xray-note">{{ note }}</span></div>
    <div class="xray-word" v-if="word">{{ word }}</div>
  </div>`,
  props: { name: String },
  data: () => ({ note: "", word: "Loading the X-ray", label: "" }),

  mounted() {
    this.state = { marks: [], begun: null, pairs: [], outlines: [], metal: [], outside: [], ellipses: [], epipolar: {},
      layers: {}, mode: "mark", selected: null, heard: 0, editable: true, movable: false, brush: 20, counts: false };
    this.levels = [];
    this.place = { u: 0, v: 0, zoom: 1 }; // the image position in the middle, and screen pixels an image pixel
    this.bounds = [0, 65535]; this.inverted = false; this.loupe = true;
    this.cursor = null; this.line = null; this.drag = null; this.touches = new Map(); this.trail = null;
    this.times = []; this.drawn = 0; this.blink = true;
    this.turn = 0; this.stepped = null; this.later = null;
    this.label = `X-ray ${this.name}. Press ? for keys.`;
    const over = this.$refs.over;
    for (const [kind, act] of Object.entries({ pointerdown: this.down, pointermove: this.move, pointerup: this.up,
      pointercancel: this.up, pointerleave: this.leave, keydown: this.key, focus: this.ask, blur: this.ask }))
      over.addEventListener(kind, act);
    over.addEventListener("wheel", this.wheel, { passive: false });
    this.watcher = new ResizeObserver(() => this.resized());
    this.watcher.observe(this.$el);
    this.hear = (event) => { if (event.detail.view !== this.name) { this.line = event.detail; this.ask(); } };
    window.addEventListener("xray-cursor", this.hear);
    this.blinker = setInterval(() => { if (this.state.layers.blink) { this.blink = !this.blink; this.ask(); } }, 450);
    (window.screwposeViewers ??= {})[this.name] = this;
    this.start();
    this.$emit("ready");
  },

  beforeUnmount() {
    this.watcher.disconnect();
    clearInterval(this.blinker);
    window.removeEventListener("xray-cursor", this.hear);
    this.gl?.getExtension("WEBGL_lose_context")?.loseContext();
    if (window.screwposeViewers?.[this.name] === this) delete window.screwposeViewers[this.name];
  },

  methods: {
    // ---- what the server says
    set(changes) {
      Object.assign(this.state, changes);
      this.keepStepped();
      this.$el.classList.toggle("painting", this.state.mode === "paint");
      this.ask();
    },
    async show(source) {
      if (this.shown === source.key) return;
      this.shown = source.key;
      this.word = "Loading the X-ray";
      const answer = await fetch(source.url);
      if (!answer.ok) { this.word = "The X-ray could not be loaded."; return; }
      const data = new Uint16Array(await answer.arrayBuffer());
      if (this.shown !== source.key) return;
      this.levels = [{ data, width: source.width, height: source.height }];
      while (Math.max(this.levels.at(-1).width, this.levels.at(-1).height) > 700) this.levels.push(halved(this.levels.at(-1)));
      this.window = source.window;
      this.bounds = [...source.window];
      this.upload();
      this.word = "";
      this.fit();
      this.$el.dataset.shown = source.key;
    },
    preset(name) {
      const [low, high] = this.window ?? [0, 65535], span = high - low;
      this.bounds = { auto: [low, high], full: [0, 65535], metal: [low, low + 0.35 * span], bone: [low + 0.25 * span, high] }[name];
      this.ask();
    },
    invert() { this.inverted = !this.inverted; this.ask(); },
    toggleLoupe() { this.loupe = !this.loupe; this.ask(); },
    lookAt(u, v) { this.place.u = u; this.place.v = v; this.ask(); },

    // ---- the graphics card
    start() {
      const gl = this.$refs.image.getContext("webgl2", { antialias: false, alpha: false });
      if (!gl) { this.word = "This browser has no WebGL 2, which showing 16-bit X-rays needs."; return; }
      this.gl = gl;
      this.program = gl.createProgram();
      gl.attachShader(this.program, compiled(gl, gl.VERTEX_SHADER, VERTEX));
      gl.attachShader(this.program, compiled(gl, gl.FRAGMENT_SHADER, FRAGMENT));
      gl.linkProgram(this.program);
      gl.useProgram(this.program);
      this.at = Object.fromEntries(["image", "size", "origin", "step_px", "height", "corner", "bounds", "inverted", "outside"].map(
        (name) => [name, gl.getUniformLocation(this.program, name)]));
      this.$refs.image.addEventListener("webglcontextlost", (event) => event.preventDefault());
      this.$refs.image.addEventListener("webglcontextrestored", () => { this.start(); if (this.levels.length) this.upload(); });
    },
    upload() {
      const gl = this.gl;
      if (!gl) return;
      this.textures?.forEach((texture) => gl.deleteTexture(texture));
      gl.pixelStorei(gl.UNPACK_ALIGNMENT, 2);
      this.textures = this.levels.map(({ data, width, height }) => {
        const texture = gl.createTexture();
        gl.bindTexture(gl.TEXTURE_2D, texture);
        gl.texImage2D(gl.TEXTURE_2D, 0, gl.R16UI, width, height, 0, gl.RED_INTEGER, gl.UNSIGNED_SHORT, data);
        for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
        return texture;
      });
      this.ask();
    },
    // Draw a part of the image into a rectangle of the canvas (device pixels from its lower left).
    paint(u, v, zoom, x, y, width, height) {
      const gl = this.gl;
      let level = clamp(Math.floor(Math.log2(1 / zoom)), 0, this.levels.length - 1);
      const { width: w, height: h } = this.levels[level], scale = 2 ** level;
      gl.viewport(x, y, width, height);
      gl.scissor(x, y, width, height);
      gl.bindTexture(gl.TEXTURE_2D, this.textures[level]);
      gl.uniform2f(this.at.size, w, h);
      // Of the coarser image pixel 0 is the mean of the first `scale` ones: its centre is half of them in.
      const coarse = (z) => (z + 0.5) / scale - 0.5;
      gl.uniform2f(this.at.origin, coarse(u - (width / 2 - 0.5) / zoom), coarse(v - (height / 2 - 0.5) / zoom));
      gl.uniform1f(this.at.step_px, 1 / zoom / scale);
      gl.uniform1f(this.at.height, height);
      gl.uniform2f(this.at.corner, x, y);
      gl.uniform2f(this.at.bounds, ...this.bounds);
      gl.uniform1i(this.at.inverted, this.inverted);
      gl.uniform3f(this.at.outside, 0.03, 0.03, 0.03); // dark in the light theme too: an X-ray is read in the dark
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    },
    resized() {
      const ratio = window.devicePixelRatio || 1, box = this.$el.getBoundingClientRect();
      for (const canvas of [this.$refs.image, this.$refs.over]) {
        canvas.width = Math.max(1, Math.round(box.width * ratio));
        canvas.height = Math.max(1, Math.round(box.height * ratio));
      }
      this.ratio = ratio;
      // Marks and words grow with the page's own, which grow with the screen.
      this.unit = ratio * Math.max(1, parseFloat(getComputedStyle(document.documentElement).fontSize) / 16);
      this.untouched !== false ? this.fit() : this.ask();
    },
    fit() {
      const level = this.levels[0];
      if (!level) return;
      const { width, height } = this.$refs.over;
      this.place = { u: (level.width - 1) / 2, v: (level.height - 1) / 2, zoom: 0.98 * Math.min(width / level.width, height / level.height) };
      this.untouched = true;
      this.ask();
    },
    // The next frame draws; however much happens before it, it draws once.
    ask() {
      if (this.asked) return;
      this.asked = true;
      requestAnimationFrame(() => { this.asked = false; this.frame(); });
    },
    frame() {
      const began = performance.now(), gl = this.gl, over = this.$refs.over;
      if (!over) return;
      const draw = over.getContext("2d");
      draw.reset();  // not clearRect: where nothing visible is drawn after it, Chromium may go on showing what was there
      if (!gl || !this.levels.length) return;
      const { u, v, zoom } = this.place;
      gl.enable(gl.SCISSOR_TEST);
      this.paint(u, v, zoom, 0, 0, over.width, over.height);
      this.overlays(draw, (p) => this.toScreen(p), zoom);
      if (this.loupe && this.cursor && (this.state.mode === "mark" || this.drag?.mark)) this.magnify(draw);
      this.times.push(performance.now() - began);
      if (this.times.length > 2000) this.times.splice(0, 1000);
      this.drawn++;
      this.$el.dataset.drawn = this.drawn;
      const position = this.cursor ? `  ${this.cursor[0].toFixed(1)}, ${this.cursor[1].toFixed(1)}` : "";
      const note = `${Math.round((100 * zoom) / (this.ratio || 1))} %${position}`;
      if (note !== this.note) this.note = note;
    },
    magnify(draw) {
      const size = Math.round(LOUPE_PX * this.unit), over = this.$refs.over, [x, y] = this.toScreen(this.cursor);
      const margin = Math.round(10 * this.ratio), zoom = LOUPE_ZOOM * Math.max(this.place.zoom, 0.5 * this.ratio);
      // In the corner that the hand is not in.
      const left = x > over.width / 2 ? margin : over.width - size - margin;
      const top = over.height - size - margin;
      const low = y > over.height * 0.55 && Math.abs(x - left - size / 2) < size ? margin + 30 * this.ratio : top;
      this.paint(...this.cursor, zoom, left, over.height - low - size, size, size);
      draw.save();
      draw.beginPath(); draw.rect(left, low, size, size); draw.clip();
      const [cu, cv] = this.cursor;
      draw.clearRect(left, low, size, size);
      this.overlays(draw, ([pu, pv]) => [left + size / 2 + (pu - cu) * zoom, low + size / 2 + (pv - cv) * zoom], zoom, true);
      draw.strokeStyle = "#fff"; draw.lineWidth = this.ratio; draw.globalAlpha = 0.9;
      draw.beginPath();
      const mx = left + size / 2, my = low + size / 2, gap = 5 * this.ratio;
      for (const [ax, ay, bx, by] of [[left, my, mx - gap, my], [mx + gap, my, left + size, my], [mx, low, mx, my - gap], [mx, my + gap, mx, low + size]]) {
        draw.moveTo(ax, ay); draw.lineTo(bx, by);
      }
      draw.stroke();
      draw.restore();
      draw.strokeStyle = "#8aa0b5"; draw.lineWidth = 1.5 * this.ratio;
      draw.strokeRect(left, low, size, size);
    },

    // ---- what lies over the X-ray
    overlays(draw, to, zoom, inLoupe = false) {
      const s = this.state, layers = s.layers, unit = this.unit || 1;
      const path = (flat, close = true) => {
        for (let k = 0; k < flat.length; k += 2) { const [x, y] = to([flat[k], flat[k + 1]]); k ? draw.lineTo(x, y) : draw.moveTo(x, y); }
        if (close) draw.closePath();
      };
      draw.lineJoin = "round";
      if (s.outside.length && layers.mask !== false) {
        draw.beginPath(); s.outside.forEach((one) => path(one));
        draw.fillStyle = "rgba(86, 130, 190, 0.30)"; draw.fill("evenodd");
      }
      const shown = !layers.blink || this.blink;
      if (layers.difference && s.metal.length && !inLoupe) {
        this.difference(draw, path);
      } else if (shown) {
        for (const one of s.outlines) {
          if (!one.paths.length) continue;
          draw.beginPath(); one.paths.forEach((p) => path(p));
          draw.globalAlpha = layers.opacity ?? 0.3; draw.fillStyle = one.color; draw.fill("evenodd");
          draw.globalAlpha = 1;
          if (layers.outline !== false) {
            draw.setLineDash((DASHES[one.dash] ?? []).map((x) => x * unit));
            draw.strokeStyle = one.color; draw.lineWidth = (one.name === s.selected ? 2.6 : 1.4) * unit; draw.stroke();
            draw.setLineDash([]);
          }
        }
      }
      if (layers.ellipses !== false) for (const one of s.ellipses) {
        draw.beginPath();
        path(one.path.map((x, k) => one.at[k % 2] + x * one.times));
        draw.strokeStyle = one.color; draw.lineWidth = 1.5 * unit; draw.stroke();
      }
      if (layers.ellipses !== false && s.ellipses.length && !inLoupe)
        this.text(draw, [12 * unit, this.$refs.over.height - 14 * unit], `Ellipses: expected errors of the tips, \u00d7${s.ellipses[0].times}`, "#ffffff", 12);
      if (this.line && s.mode === "mark" && s.epipolar[this.line.view]) this.epipolarLine(draw, to, s.epipolar[this.line.view]);
      if (layers.marks !== false) this.marks(draw, to, unit, inLoupe);
      if (this.trail) {
        draw.beginPath(); path(this.trail.flat(), false);
        draw.strokeStyle = s.counts ? "rgba(120, 220, 140, 0.5)" : "rgba(86, 130, 190, 0.6)";
        draw.lineWidth = 2 * s.brush * zoom; draw.lineCap = "round"; draw.stroke(); draw.lineCap = "butt";
      }
      if (s.mode === "paint" && this.cursor && !inLoupe) {
        const [x, y] = to(this.cursor);
        draw.beginPath(); draw.arc(x, y, s.brush * zoom, 0, 7); draw.strokeStyle = "#fff"; draw.lineWidth = unit; draw.stroke();
      }
    },
    // What only one of model and metal covers: model alone amber, metal alone blue.
    difference(draw, path) {
      const { width, height } = this.$refs.over, layer = (this.sheet ??= document.createElement("canvas"));
      const fill = (shapes, color, how) => {
        pen.globalCompositeOperation = how; pen.fillStyle = color; pen.beginPath();
        shapes.forEach((flat) => {
          for (let k = 0; k < flat.length; k += 2) { const [x, y] = this.toScreen([flat[k], flat[k + 1]]); k ? pen.lineTo(x, y) : pen.moveTo(x, y); }
          pen.closePath();
        });
        pen.fill("evenodd");
      };
      layer.width = width; layer.height = height;
      const pen = layer.getContext("2d"), models = this.state.outlines.map((one) => one.paths);
      draw.globalAlpha = 0.75;
      pen.clearRect(0, 0, width, height);
      models.forEach((paths) => fill(paths, "#e69f00", "source-over"));
      fill(this.state.metal, "#000", "destination-out");
      draw.drawImage(layer, 0, 0);
      pen.clearRect(0, 0, width, height);
      fill(this.state.metal, "#56b4e9", "source-over");
      models.forEach((paths) => fill(paths, "#000", "destination-out"));
      draw.drawImage(layer, 0, 0);
      draw.globalAlpha = 1;
    },
    // The points x with x . (F p) = 0, across the image.
    epipolarLine(draw, to, F) {
      const p = [this.line.u, this.line.v, 1], [a, b, c] = F.map((row) => row.reduce((sum, x, k) => sum + x * p[k], 0));
      const { width, height } = this.levels[0], ends = [];
      if (Math.abs(b) > Math.abs(a)) for (const u of [-0.5, width - 0.5]) ends.push([u, -(a * u + c) / b]);
      else for (const v of [-0.5, height - 0.5]) ends.push([-(b * v + c) / a, v]);
      draw.beginPath(); draw.moveTo(...to(ends[0])); draw.lineTo(...to(ends[1]));
      draw.strokeStyle = "rgba(0,0,0,0.6)"; draw.lineWidth = 3.5 * this.unit; draw.stroke();
      draw.strokeStyle = "#8fd3ff"; draw.lineWidth = 1.3 * this.unit; draw.setLineDash([8 * this.unit, 5 * this.unit]);
      draw.stroke(); draw.setLineDash([]);
    },
    marks(draw, to, unit, inLoupe) {
      const s = this.state, stroke = (color, width) => {
        draw.strokeStyle = "rgba(0,0,0,0.75)"; draw.lineWidth = width + 2.2 * unit; draw.stroke();
        draw.strokeStyle = color; draw.lineWidth = width; draw.stroke();
      };
      for (const one of s.pairs) {
        const [tip, center] = one.points.map(to), r = 4 * unit;
        draw.beginPath(); draw.moveTo(tip[0], tip[1] - r); draw.lineTo(tip[0] + r, tip[1] + r); draw.lineTo(tip[0] - r, tip[1] + r); draw.closePath();
        draw.moveTo(center[0] + r, center[1]); draw.arc(...center, r, 0, 7);
        stroke(one.color, 1.2 * unit);
      }
      const all = s.begun ? [...s.marks, { label: s.begun.label, tip: s.begun.tip, center: null, color: "#ffffff" }] : s.marks;
      for (const one of all) {
        const moving = this.drag?.mark, tip = moving?.label === one.label && moving.which === "tip" ? this.drag.at : one.tip;
        const center = moving?.label === one.label && moving.which === "center" ? this.drag.at : one.center;
        const on = s.selected && s.selected.label === one.label, r = (on ? 9 : 7) * unit;
        const t = to(tip), c = center ? to(center) : s.begun && this.cursor && !inLoupe ? to(this.cursor) : null;
        if (c) {
          draw.beginPath(); draw.moveTo(...t); draw.lineTo(...c);
          draw.setLineDash([6 * unit, 5 * unit]); stroke(one.color, 1.1 * unit); draw.setLineDash([]);
        }
        draw.beginPath(); // a cross with an open middle: the tip itself stays visible
        for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) { draw.moveTo(t[0] + dx * r * 0.3, t[1] + dy * r * 0.3); draw.lineTo(t[0] + dx * r, t[1] + dy * r); }
        stroke(one.color, 1.8 * unit);
        if (center) { draw.beginPath(); draw.arc(...c, r * 0.75, 0, 7); stroke(one.color, 1.8 * unit); }
        if (on) {
          const point = to(s.selected.which === "tip" || !center ? tip : center);
          draw.beginPath(); draw.rect(point[0] - 13 * unit, point[1] - 13 * unit, 26 * unit, 26 * unit);
          draw.setLineDash([4 * unit, 4 * unit]); stroke("#ffffff", unit); draw.setLineDash([]);
        }
        if (!inLoupe) { // beyond the tip, where no metal is
          const away = c ? [t[0] - c[0], t[1] - c[1]] : [1, 1], long = Math.hypot(...away) || 1;
          draw.textAlign = "center"; draw.textBaseline = "middle";
          this.text(draw, [t[0] + (22 * unit * away[0]) / long, t[1] + (22 * unit * away[1]) / long], one.label, one.color, 14);
          draw.textAlign = "start"; draw.textBaseline = "alphabetic";
        }
      }
    },
    text(draw, [x, y], words, color, size) {
      draw.font = `600 ${size * this.unit}px system-ui, sans-serif`;
      draw.lineWidth = 3.5 * this.unit; draw.strokeStyle = "rgba(0,0,0,0.8)";
      draw.strokeText(words, x, y); draw.fillStyle = color; draw.fillText(words, x, y);
    },

    // ---- hands
    toScreen([u, v]) {
      const { width, height } = this.$refs.over, { u: cu, v: cv, zoom } = this.place;
      return [width / 2 + (u - cu) * zoom, height / 2 + (v - cv) * zoom];
    },
    toImage(event) {
      const box = this.$refs.over.getBoundingClientRect(), { width, height } = this.$refs.over, { u, v, zoom } = this.place;
      return [u + ((event.clientX - box.left) * this.ratio - width / 2) / zoom, v + ((event.clientY - box.top) * this.ratio - height / 2) / zoom];
    },
    nearest([u, v]) {
      let best = null, least = (NEAR_PX * this.unit) / this.place.zoom;
      for (const one of this.state.marks) for (const which of ["tip", "center"]) {
        const far = Math.hypot(one[which][0] - u, one[which][1] - v);
        if (far < least) { least = far; best = { label: one.label, which }; }
      }
      return best;
    },
    outlineAt(point) {
      const draw = this.$refs.over.getContext("2d"), [x, y] = this.toScreen(point);
      return this.state.outlines.findLast((one) => {
        draw.beginPath();
        one.paths.forEach((flat) => { for (let k = 0; k < flat.length; k += 2) { const p = this.toScreen([flat[k], flat[k + 1]]); k ? draw.lineTo(...p) : draw.moveTo(...p); } draw.closePath(); });
        return draw.isPointInPath(x, y, "evenodd");
      });
    },
    tell() {
      window.dispatchEvent(new CustomEvent("xray-cursor", { detail: { view: this.name, u: this.cursor[0], v: this.cursor[1] } }));
    },
    down(event) {
      this.$refs.over.focus();
      this.rest();
      this.$refs.over.setPointerCapture(event.pointerId);
      this.touches.set(event.pointerId, event);
      const at = this.toImage(event), s = this.state;
      this.cursor = at;
      if (this.touches.size === 2) { this.drag = { pinch: this.spread() }; this.trail = null; return; }
      this.drag = { from: [event.clientX, event.clientY], last: [event.clientX, event.clientY], start: at, button: event.button, moved: false };
      if (event.button === 2 || event.shiftKey) { this.drag.window = [...this.bounds]; return; }
      if (event.button !== 0) return;
      if (s.mode === "mark" && s.editable) {
        const near = s.begun ? null : this.nearest(at); // a centre may lie on another screw's point
        if (near) {
          const point = s.marks.find((one) => one.label === near.label)[near.which];
          Object.assign(this.drag, { mark: near, at: point, offset: [point[0] - at[0], point[1] - at[1]] });
          s.selected = near;
          this.$emit("selected", { ...near });
        }
      } else if (s.mode === "paint" && s.editable) {
        this.trail = [at];
      } else if (s.mode === "pose" && !event.altKey) {
        const hit = this.outlineAt(at);
        if (hit) { this.$emit("picked", { name: hit.name }); if (s.movable) this.drag.pose = hit.name; }
      }
      this.ask();
    },
    move(event) {
      const at = this.toImage(event), drag = this.drag;
      this.cursor = at;
      if (this.touches.has(event.pointerId)) this.touches.set(event.pointerId, event);
      if (drag?.pinch) {
        const now = this.spread();
        this.zoomAt(drag.pinch.middle, now.far / drag.pinch.far); // where the fingers were: what lay there goes with them
        this.pan(now.middle[0] - drag.pinch.middle[0], now.middle[1] - drag.pinch.middle[1]);
        drag.pinch = now;
      } else if (drag) {
        const dx = event.clientX - drag.last[0], dy = event.clientY - drag.last[1];
        if (Math.hypot(event.clientX - drag.from[0], event.clientY - drag.from[1]) > CLICK_PX) drag.moved = true;
        if (drag.window) {
          const scale = 65535 / 700, [low, high] = drag.window;
          const wide = Math.max(200, high - low + (event.clientX - drag.from[0]) * scale), middle = (low + high) / 2 + (event.clientY - drag.from[1]) * scale;
          this.bounds = [middle - wide / 2, middle + wide / 2];
        } else if (this.trail) this.trail.push(at);
        else if (drag.mark) { if (drag.moved) drag.at = [at[0] + drag.offset[0], at[1] + drag.offset[1]]; }
        else if (drag.pose) {
          if (drag.moved) this.$emit("nudged", { name: drag.pose, u: at[0] - drag.start[0], v: at[1] - drag.start[1], done: false });
        } else if (drag.moved) this.pan(dx, dy);
        drag.last = [event.clientX, event.clientY];
      }
      if (drag?.mark && drag.moved) this.cursor = drag.at;
      this.tell();
      this.ask();
    },
    up(event) {
      const drag = this.drag, s = this.state;
      this.touches.delete(event.pointerId);
      if (this.touches.size || !drag) { this.drag = null; return; }
      const at = this.toImage(event);
      if (this.trail) { this.$emit("painted", { points: this.trail }); this.trail = null; }
      else if (drag.mark) {
        if (drag.moved) {
          const one = s.marks.find((mark) => mark.label === drag.mark.label);
          if (one) one[drag.mark.which] = drag.at; // shown there until the server says so too
          this.$emit("moved", { ...drag.mark, u: drag.at[0], v: drag.at[1] });
        }
      } else if (drag.pose) { if (drag.moved) this.$emit("nudged", { name: drag.pose, u: at[0] - drag.start[0], v: at[1] - drag.start[1], done: true }); }
      else if (!drag.moved && !drag.pinch && !drag.window && drag.button === 0 && s.mode === "mark" && s.editable && event.type === "pointerup") this.put(at);
      this.drag = null;
      this.ask();
    },
    leave() { if (!this.drag) { this.cursor = null; this.ask(); window.dispatchEvent(new CustomEvent("xray-cursor", { detail: { view: null } })); } },
    put([u, v]) {
      const level = this.levels[0];
      if (level && u >= -0.5 && v >= -0.5 && u <= level.width - 0.5 && v <= level.height - 0.5) this.$emit("placed", { u, v });
    },
    spread() {
      const [a, b] = [...this.touches.values()], middle = [(a.clientX + b.clientX) / 2, (a.clientY + b.clientY) / 2];
      return { far: Math.max(10, Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY)), middle };
    },
    pan(dx, dy) {
      this.place.u -= (dx * this.ratio) / this.place.zoom;
      this.place.v -= (dy * this.ratio) / this.place.zoom;
      this.untouched = false;
      this.ask();
    },
    zoomAt([x, y], factor) {
      const before = this.toImage({ clientX: x, clientY: y });
      this.place.zoom = clamp(this.place.zoom * factor, 0.02, 80);
      const after = this.toImage({ clientX: x, clientY: y });
      this.place.u += before[0] - after[0];
      this.place.v += before[1] - after[1];
      this.untouched = false;
      this.ask();
    },
    wheel(event) {
      event.preventDefault();
      this.zoomAt([event.clientX, event.clientY], Math.exp(-clamp(event.deltaY, -240, 240) * 0.0022));
    },
    middle() { const box = this.$refs.over.getBoundingClientRect(); return [box.left + box.width / 2, box.top + box.height / 2]; },

    // Everything that a hand can do, by keys.
    key(event) {
      if (event.ctrlKey || event.metaKey) return;
      const s = this.state, arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
      const far = event.altKey ? 10 : event.shiftKey ? 1 : 0.1;
      let known = true;
      if (!(event.key in arrows) && !["Shift", "Alt"].includes(event.key)) this.rest(); // what follows is about the point as it is
      if (event.key in arrows) {
        const [x, y] = arrows[event.key];
        if (s.mode === "pose" && s.movable && s.selected) this.$emit("nudged", { name: s.selected, u: x * far, v: y * far, done: true });
        else if (s.mode === "mark" && s.editable && s.selected) this.step(x * far, y * far);
        else this.pan(-40 * x, -40 * y);
      } else if (event.key === "+" || event.key === "=") this.zoomAt(this.middle(), 1.25);
      else if (event.key === "-") this.zoomAt(this.middle(), 0.8);
      else if (event.key === "0") this.fit();
      else if (event.key === "i") this.invert();
      else if (event.key === "o") this.toggleLoupe();
      else if (["1", "2", "3", "4"].includes(event.key)) this.preset(["auto", "full", "metal", "bone"][event.key - 1]);
      else if (s.mode === "pose" && s.movable && s.selected && "rRtTaAdD".includes(event.key)) this.$emit("turned", { key: event.key.toLowerCase(), back: event.shiftKey, name: s.selected });
      else if (s.mode === "mark" && s.editable && event.key === "n") this.put([this.place.u, this.place.v]);
      else if (s.mode === "mark" && event.key === "Enter") this.$emit("entered", { u: this.place.u, v: this.place.v });
      else if (event.key === "[" || event.key === "]") this.$emit("stepped", { by: event.key === "]" ? 1 : -1 });
      else if (s.mode === "mark" && s.editable && s.selected && (event.key === "t" || event.key === "c")) this.$emit("selected", { label: s.selected.label, which: event.key === "t" ? "tip" : "center" });
      else if (s.mode === "mark" && s.editable && (event.key === "Delete" || event.key === "Backspace")) this.$emit("removed");
      else if (event.key === "Escape") this.$emit("escaped");
      else known = false;
      if (known) { event.preventDefault(); event.stopPropagation(); }
    },
    // A point moves at once on the screen; the server hears of the last place when the hand rests. Until it answers to
    // the last step, what it says of the point is where an earlier rest was: the next step must not begin there.
    step(du, dv) {
      const { label, which } = this.state.selected, begun = this.state.begun?.label === label;
      const one = begun ? this.state.begun : this.state.marks.find((mark) => mark.label === label);
      const point = one && (begun ? one.tip : one[which]);
      if (!point) return;
      point[0] += du; point[1] += dv;
      this.cursor = [...point];
      this.stepped = { label, which: begun ? "tip" : which, u: point[0], v: point[1], turn: ++this.turn };
      this.tell();
      this.ask();
      clearTimeout(this.later);
      this.later = setTimeout(() => this.rest(), 120);
    },
    rest() {
      if (!this.later) return;
      clearTimeout(this.later);
      this.later = null;
      this.$emit("moved", this.stepped);
    },
    keepStepped() {
      if (!this.stepped || this.state.heard >= this.turn) { this.stepped = null; return; }
      const { label, which, u, v } = this.stepped, s = this.state;
      if (which === "tip" && s.begun?.label === label) s.begun.tip = [u, v];
      const one = s.marks.find((mark) => mark.label === label);
      if (one) one[which] = [u, v];
    },
  },
};
