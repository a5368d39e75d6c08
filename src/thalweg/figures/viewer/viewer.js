"use strict";
// A point cloud from disk: nodes of an octree as scripts, drawn coarse to fine within a budget of points.
// Where there are panoramas, the eye may stand in one of them: it is drawn behind the points and through them.
// Units are metres; x east, y north, z up. Positions on the GPU are relative to the eye: single precision
// would lose millimetres in map coordinates.

const $ = (id) => document.getElementById(id);
const scene = $("scene"), marks = $("marks");
const gl = scene.getContext("webgl2", { antialias: false, preserveDrawingBuffer: true });
const HALF_VIEW = Math.tan(25 * Math.PI / 180);
const LEAST_BUDGET = 60_000, MOST_BUDGET = 3_000_000, LEAST_NODE_PX = 110, AT_ONCE = 6;
const COLOURS = ["rgb", "height", "intensity", "sigma", "time", "range", ...DATA.extras];
const WORDS = { rgb: "photographs", sigma: "standard deviation" };
const columns = Object.fromEntries(DATA.columns.map(([name, width, bytes]) => [name, { width, bytes }]));

// ---------------------------------------------------------------- nodes

const nodes = new Map();
for (const [key, [n, spacing]] of Object.entries(DATA.nodes)) {
  let size = DATA.size;
  const corner = [...DATA.corner];
  for (const digit of key) {
    size /= 2;
    for (let axis = 0; axis < 3; axis++) corner[axis] += size * (digit >> axis & 1);
  }
  nodes.set(key, { key, n, spacing, size, corner, state: "absent", children: [] });
}
for (const node of nodes.values()) if (node.key) nodes.get(node.key.slice(0, -1)).children.push(node);
let loading = 0;

function load(node) {
  readScript(node, `nodes/r${node.key}.js`);
}

function readScript(what, source) {
  what.state = "loading";
  loading++;
  const script = document.createElement("script");
  script.src = source;
  script.onload = () => script.remove();
  script.onerror = () => {
    what.state = "missing";
    loading--;
    say(`${source} cannot be read: copy the whole folder, this page and "${source.split("/")[0]}" beside it.`);
  };
  document.head.append(script);
}

const bytesOf = (letters) => Uint8Array.from(atob(letters), (letter) => letter.charCodeAt(0));

async function thalwegNode(key, letters) {
  const node = nodes.get(key);
  const stream = new Blob([bytesOf(letters)]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  let at = 0;
  const column = (width, size) => {  // planes of bytes -> rows of whole numbers
    const found = size === 2 ? new Uint16Array(node.n * width) : new Uint8Array(node.n * width);
    for (let axis = 0; axis < width; axis++)
      for (let byte = 0; byte < size; byte++, at += node.n)
        for (let k = 0; k < node.n; k++) found[k * width + axis] |= bytes[at + k] << 8 * byte;
    return found;
  };
  node.xyz = column(3, 2);
  for (const name in columns) node[name] = column(columns[name].width, columns[name].bytes);
  node.buffers = upload(node);
  node.state = "here";
  loading--;
  redraw();
}

function upload(node) {
  // 20 bytes a point: x y z time (16 bit), colour and intensity, sigmas and range, whether it has a colour, extras
  const n = node.n, place = new Uint16Array(4 * n), look = new Uint8Array(12 * n);
  for (let k = 0; k < n; k++) {
    for (let axis = 0; axis < 3; axis++) {
      place[4 * k + axis] = node.xyz[3 * k + axis];
      look[12 * k + axis] = node.rgb ? node.rgb[3 * k + axis] : 128;
      look[12 * k + 4 + axis] = node.sigma ? node.sigma[3 * k + axis] : 0;
    }
    place[4 * k + 3] = node.time ? node.time[k] : 0;
    look[12 * k + 3] = node.intensity ? node.intensity[k] : 0;
    look[12 * k + 7] = node.range ? node.range[k] : 0;
    look[12 * k + 8] = node.coloured ? node.coloured[k] : 1;
    for (let e = 0; e < DATA.extras.length; e++) look[12 * k + 9 + e] = node.extra[DATA.extras.length * k + e];
  }
  const vao = gl.createVertexArray();
  gl.bindVertexArray(vao);
  const attribute = (data, parts) => {
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
    for (const [index, width, type, scaled, stride, offset] of parts) {
      gl.enableVertexAttribArray(index);
      gl.vertexAttribPointer(index, width, type, scaled, stride, offset);
    }
  };
  attribute(place, [[0, 4, gl.UNSIGNED_SHORT, true, 8, 0]]);
  attribute(look, [[1, 4, gl.UNSIGNED_BYTE, true, 12, 0], [2, 4, gl.UNSIGNED_BYTE, false, 12, 4],
    [3, 4, gl.UNSIGNED_BYTE, false, 12, 8]]);
  gl.bindVertexArray(null);
  return vao;
}

const placeOf = (node, k) => [0, 1, 2].map((i) => node.corner[i] + (node.xyz[3 * k + i] + 0.5) / 65536 * node.size);
const sigmaOf = (code) => code ? DATA.sigma[0] * Math.exp((code - 1) * DATA.sigma[1]) : NaN;

// ---------------------------------------------------------------- programs of the GPU

const POINTS = `#version 300 es
layout(location = 0) in vec4 place; layout(location = 1) in vec4 look;
layout(location = 2) in vec4 errors; layout(location = 3) in vec4 more;
uniform mat4 project; uniform vec3 corner; uniform float size, base, scale, least, gaps[8];
uniform int mode; uniform ivec3 clouds; uniform bool bare; uniform vec2 limits, sigma, heights; uniform vec4 cut; uniform sampler2D ramps; uniform uint number;
flat out vec3 colour; flat out uint id;
float sd(float code) { return code < 0.5 ? 0.0 : sigma.x * exp((code - 1.0) * sigma.y); }
void main() {
  gl_Position = project * vec4(corner + place.xyz * size, 1.0);
  ivec3 upper = ivec3(greaterThan(place.xyz, vec3(0.5)));
  gl_PointSize = clamp(scale * gaps[upper.x | upper.y << 1 | upper.z << 2] / gl_Position.w, least, 40.0);
  float up = base + place.z * size;
  vec2 away = cut.xy * (corner + place.xyz * size).xy;
  if (bare && more.x < 0.5 || up < heights.x || up > heights.y || abs(away.x + away.y - cut.z) > cut.w)
    gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  if (clouds.x > 0 && (clouds.z >> int(round((more[clouds.x] - 1.0) / 254.0 * float(clouds.y))) & 1) == 0)
    gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  id = number << 18 | uint(gl_VertexID);
  float value = 0.0; bool known = true;
  if (mode == 0) { colour = look.rgb; return; }
  if (mode == 1) value = (up - limits.x) / (limits.y - limits.x);
  if (mode == 2) value = look.a;
  if (mode == 3) {
    vec3 s = vec3(sd(errors.x), sd(errors.y), sd(errors.z));
    known = errors.x + errors.y + errors.z > 0.5;
    value = log(max(length(s), 1e-6) / limits.x) / log(limits.y / limits.x);
  }
  if (mode == 4) value = place.w;
  if (mode == 5) value = errors.w / 255.0;
  if (mode > 5) { value = (more[mode - 5] - 1.0) / 254.0; known = more[mode - 5] > 0.5; }
  vec2 at = vec2((clamp(value, 0.0, 1.0) * 255.0 + 0.5) / 256.0, (float(mode) - 0.5) / float(textureSize(ramps, 0).y));
  colour = known ? texture(ramps, at).rgb : vec3(0.5);
}`;
const SOLID = `#version 300 es
precision highp float; flat in vec3 colour; flat in uint id; out vec4 shown;
void main() {
  vec2 q = 2.0 * gl_PointCoord - 1.0;
  if (dot(q, q) > 1.0) discard;
  shown = vec4(colour, 1.0);
}`;
const NUMBERS = `#version 300 es
precision highp float; precision highp int; flat in vec3 colour; flat in uint id; out uint shown;
void main() {
  vec2 q = 2.0 * gl_PointCoord - 1.0;
  if (dot(q, q) > 1.0) discard;
  shown = id + 1u;
}`;
// Eye-dome lighting (Boucheny 2009): a point is darkened by how much nearer its neighbours on the screen are.
const WHOLE = `#version 300 es
void main() { gl_Position = vec4(gl_VertexID == 1 ? 3 : -1, gl_VertexID == 2 ? 3 : -1, 0, 1); }`;
const SHADE = `#version 300 es
precision highp float; uniform sampler2D image, depth, sky; uniform vec2 planes; uniform float strength, cover;
uniform vec3 ground, rays[3]; uniform bool inside; out vec4 shown;
vec3 behind() {  // equirectangular, as thalweg.panorama.sphere
  if (!inside) return ground;
  vec2 q = 2.0 * gl_FragCoord.xy / vec2(textureSize(depth, 0)) - 1.0;
  vec3 d = normalize(rays[0] * q.x + rays[1] * q.y + rays[2]);
  return texture(sky, vec2(atan(d.x, d.z) / 6.28318531 + 0.5, asin(clamp(d.y, -1.0, 1.0)) / 3.14159265 + 0.5)).rgb;
}
float far(ivec2 at) {
  float d = texelFetch(depth, clamp(at, ivec2(0), textureSize(depth, 0) - 1), 0).r;
  return d >= 1.0 ? 1e9 : log2(planes.x * planes.y / (planes.y - d * (planes.y - planes.x)));
}
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  float own = far(at), sum = 0.0;
  if (own > 1e8) { shown = vec4(behind(), 1.0); return; }
  for (int k = 0; k < 8; k++) {
    float angle = float(k) * 0.785398;
    sum += clamp(own - far(at + ivec2(round(1.6 * vec2(cos(angle), sin(angle))))), 0.0, 0.5);
  }
  vec3 own_colour = texelFetch(image, at, 0).rgb * exp(-strength * sum);
  shown = vec4(mix(behind(), own_colour, cover), 1.0);
}`;
const LINES = `#version 300 es
layout(location = 0) in vec3 place; uniform mat4 project; uniform vec3 corner;
void main() { gl_Position = project * vec4(place + corner, 1.0); }`;
const PLAIN = `#version 300 es
precision highp float; uniform vec3 tone; out vec4 shown;
void main() { shown = vec4(tone, 1.0); }`;

function program(vertex, fragment) {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  const at = {};
  for (let k = 0; k < gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS); k++) {
    const { name } = gl.getActiveUniform(made, k);
    at[name] = gl.getUniformLocation(made, name);
  }
  return { made, at };
}

function target(width, height, inner, form, type) {  // a picture and its depth, drawn apart from the screen
  const made = { frame: gl.createFramebuffer(), image: gl.createTexture(), depth: gl.createTexture() };
  const make = (texture, ...how) => {
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, how[0], width, height, 0, how[1], how[2], null);
    for (const key of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, key, gl.NEAREST);
  };
  make(made.image, inner, form, type);
  make(made.depth, gl.DEPTH_COMPONENT24, gl.DEPTH_COMPONENT, gl.UNSIGNED_INT);
  gl.bindFramebuffer(gl.FRAMEBUFFER, made.frame);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, made.image, 0);
  gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, made.depth, 0);
  return made;
}

let programs, targets = null, ramps, track = null;

function start() {
  programs = { points: program(POINTS, SOLID), numbers: program(POINTS, NUMBERS), shade: program(WHOLE, SHADE),
    lines: program(LINES, PLAIN) };
  const rows = COLOURS.slice(1).map((name) => Uint8Array.from(atob(DATA.ramps[name]), (c) => c.charCodeAt(0)));
  const all = new Uint8Array(rows.length * 768);
  rows.forEach((row, k) => all.set(row, 768 * k));
  ramps = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, ramps);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, 256, rows.length, 0, gl.RGB, gl.UNSIGNED_BYTE, all);
  for (const key of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, key, gl.NEAREST);
  if (DATA.track.some((place) => place)) {
    const segments = [];
    DATA.track.forEach((place, k) => {
      const next = DATA.track[k + 1];
      if (place && next) for (const each of [place, next]) segments.push(...each.map((x, i) => x - DATA.corner[i]));
    });
    track = { vao: gl.createVertexArray(), n: segments.length / 3 };
    gl.bindVertexArray(track.vao);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(segments), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    gl.bindVertexArray(null);
  }
}

// ---------------------------------------------------------------- camera

const START = { turn: 30, tilt: 35, far: 1.2 * Math.max(DATA.extent, 0.1) };
const camera = { at: [...DATA.middle], open: 75, ...START };  // looks to `turn` from north, from `tilt` above the horizon
let colour = DATA.colour;
const LAST_CLOUD = Math.max(DATA.clouds.length, 2) - 1, EACH_CLOUD = 2 ** DATA.clouds.length - 1;
let clouds = DATA.shown;  // bits: which of several clouds are drawn
const places = DATA.panoramas.map((place) => ({ ...place, state: "absent" }));
let inside = null;  // the panorama that the eye stands in

function axes() {  // unit vectors right, up, towards the eye
  const [a, b] = [camera.turn, camera.tilt].map((x) => x * Math.PI / 180);
  return [[Math.cos(a), -Math.sin(a), 0], [Math.sin(a) * Math.sin(b), Math.cos(a) * Math.sin(b), Math.cos(b)],
    [-Math.sin(a) * Math.cos(b), -Math.cos(a) * Math.cos(b), Math.sin(b)]];
}
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const minus = (a, b) => a.map((x, i) => x - b[i]);

function look() {
  const [right, up, back] = axes();
  const eye = inside ? inside.at : camera.at.map((x, i) => x + back[i] * camera.far);
  const near = inside ? 0.2 : camera.far / 200, far = (inside ? 0 : camera.far) + 3 * DATA.size;
  const half = inside ? Math.tan(camera.open * Math.PI / 360) : HALF_VIEW;
  const f = 1 / half, ratio = scene.height / scene.width;
  const c = -(far + near) / (far - near), d = -2 * far * near / (far - near);
  const project = new Float32Array(16);  // by columns
  for (let i = 0; i < 3; i++) project.set([f * ratio * right[i], f * up[i], c * back[i], -back[i]], 4 * i);
  project.set([0, 0, d, 0], 12);
  return { eye, right, up, back, near, far, half, project, pixels: scene.height / 2 / half };
}

function onScreen(place, view = look()) {  // CSS pixels; null behind the eye
  const q = minus(place, view.eye), w = -dot(q, view.back);
  if (w <= view.near) return null;
  const scale = view.pixels / w / devicePixelRatio;
  return [innerWidth / 2 + scale * dot(q, view.right), innerHeight / 2 - scale * dot(q, view.up)];
}

function move(dx, dy) {  // pixels of the screen
  if (inside) return;
  const [right, up] = axes(), scale = camera.far * 2 * HALF_VIEW / innerHeight;
  camera.at = camera.at.map((x, i) => x - scale * (dx * right[i] - dy * up[i]));
  moved();
}
function turn(dx, dy) {
  if (inside) [dx, dy] = [-dx, -dy];  // the eye turns, not the cloud
  camera.turn = (camera.turn + dx + 360) % 360;
  camera.tilt = Math.max(-89.9, Math.min(90, camera.tilt + dy));
  moved();
}
function zoom(factor) {
  if (inside) camera.open = Math.max(10, Math.min(110, camera.open * factor));
  else camera.far = Math.max(0.05, Math.min(20 * DATA.size, camera.far * factor));
  moved();
}
function home(other = {}) {
  inside = null;
  Object.assign(camera, { at: [...DATA.middle] }, START, other);
  moved();
}

const digits = (values, n) => values.map((x) => x.toFixed(n)).join(",");
function writeHash() {
  const text = (inside ? `#panorama=${encodeURIComponent(inside.name)}` : `#at=${digits(camera.at, 3)}`)
    + `&look=${digits([camera.turn, camera.tilt], 2)},${(inside ? camera.open : camera.far).toFixed(3)}&colour=${colour}`
    + (cut ? `&cut=${digits(cut, 3)}` : "") + (heights() === WHOLE_HEIGHT ? "" : `&heights=${digits(heights(), 3)}`)
    + (clouds === DATA.shown ? "" : `&clouds=${clouds}`);
  if (text !== location.hash) history.replaceState(null, "", text);
}
function readHash() {
  const found = new URLSearchParams(location.hash.slice(1));
  const numbers = (key, n) => {
    const values = (found.get(key) || "").split(",").map(parseFloat);
    return values.length === n && values.every(isFinite) ? values : null;
  };
  const at = numbers("at", 3), [a, b, far] = numbers("look", 3) || [], towards = numbers("towards", 3);
  inside = places.find((place) => place.name === found.get("panorama")) || (at ? null : places[0] || null);
  if (at) camera.at = at;
  if (far > 0) Object.assign(camera, { turn: a, tilt: b }, inside ? { open: far } : { far });
  else if (inside) Object.assign(camera, { turn: inside.heading, tilt: 0 });
  if (inside && towards) lookTo(minus(towards, inside.at));
  cut = numbers("cut", 4);
  const limits = numbers("heights", 2);
  for (const k of [0, 1]) $(["lowest", "highest"][k]).value = limits ? shareOf(limits[k]) : k;
  if (usable(found.get("colour"))) colour = found.get("colour");
  clouds = parseInt(found.get("clouds")) & EACH_CLOUD || (colour === "cloud" ? EACH_CLOUD : DATA.shown);
}

// ---------------------------------------------------------------- clip

// points stay whose height lies between two limits, and of a cut those within half its width from its plane:
// [east, north of its middle, azimuth of its normal, half width]
let cut = null;
const WHOLE_HEIGHT = [-1e9, 1e9], [BOTTOM, TOP] = DATA.heights;
const shareOf = (height) => (height - BOTTOM) / (TOP - BOTTOM);
function heights() {
  const [low, high] = ["lowest", "highest"].map((id) => Number($(id).value));
  return low <= 0 && high >= 1 ? WHOLE_HEIGHT : [low, high].map((x) => BOTTOM + x * (TOP - BOTTOM));
}
function toggleCut() {  // across the view, through the last point or what the view turns about
  const [east, north] = (picked.at(-1)?.place || (inside ? inside.at : camera.at));
  cut = cut ? null : [east, north, camera.turn, Math.max(camera.far / 100, 0.25)];
  moved();
}
function cutOf(eye) {  // normal, offset and half width, positions from the eye
  if (!cut) return [0, 0, 0, 1];
  const [s, c] = [Math.sin(cut[2] * Math.PI / 180), Math.cos(cut[2] * Math.PI / 180)];
  return [s, c, s * (cut[0] - eye[0]) + c * (cut[1] - eye[1]), cut[3]];
}

// ---------------------------------------------------------------- drawing

let budget = 1_000_000, wanted = false, still = 0, settled = false, drawn = [];
const usable = (name) => name === "height" || DATA.extras.includes(name) || (COLOURS.includes(name) && name in columns);

function redraw() {
  settled = false;
  if (!wanted) { wanted = true; requestAnimationFrame(frame); }
}
function moved() {
  clearTimeout(still);
  still = setTimeout(() => { still = 0; writeHash(); redraw(); }, 180);
  redraw();
}

function choose(view, most) {  // nodes to draw, large ones on the screen first, and which are wanted from disk
  const queue = [nodes.get("")], chosen = [], absent = [], [low, high] = heights(), [s, c, offset, reach] = cutOf(view.eye);
  let points = 0;
  const importance = (node) => {
    const centre = node.corner.map((x) => x + node.size / 2), q = minus(centre, view.eye);
    const radius = node.size * 0.87, depth = -dot(q, view.back), width = scene.width / scene.height;
    if (depth < -radius || node.corner[2] > high || node.corner[2] + node.size < low) return 0;
    if (Math.abs(s * q[0] + c * q[1] - offset) > reach + radius) return 0;
    for (const [side, half] of [[view.right, view.half * width], [view.up, view.half]])
      if (Math.abs(dot(q, side)) > half * Math.max(depth, 0) + radius * Math.hypot(1, half)) return 0;
    return node.size * view.pixels / Math.max(Math.hypot(...q) - radius, view.near);
  };
  queue[0].px = 1e9;
  while (queue.length) {
    let best = 0;
    for (let k = 1; k < queue.length; k++) if (queue[k].px > queue[best].px) best = k;
    const node = queue[best];
    queue[best] = queue[queue.length - 1];
    queue.pop();
    if (points + node.n > most) break;
    if (node.state === "absent") absent.push(node);
    if (node.state !== "here") continue;
    points += node.n;
    node.gaps = new Float32Array(8).fill(node.spacing);
    chosen.push(node);
    for (const child of node.children) {
      child.px = importance(child);
      if (child.px > LEAST_NODE_PX) queue.push(child);
    }
  }
  // where children fill the gaps between its points, those of a node may be smaller
  for (const node of [...chosen].reverse()) {
    const parts = node.children.filter((child) => child.px > 0).map((child) => node.gaps[child.key.slice(-1)]);
    const widest = parts.length ? Math.max(...parts) : node.spacing;
    if (node.key) nodes.get(node.key.slice(0, -1)).gaps[node.key.slice(-1)] = widest;
  }
  return { chosen, absent, points };
}

function drawNodes(view, { made, at }) {
  gl.useProgram(made);
  gl.activeTexture(gl.TEXTURE0);
  gl.bindTexture(gl.TEXTURE_2D, ramps);
  gl.uniform1i(at.ramps, 0);
  gl.uniformMatrix4fv(at.project, false, view.project);
  gl.uniform1i(at.mode, COLOURS.indexOf(colour));
  gl.uniform2fv(at.limits, DATA.limits[colour] || [0, 1]);
  gl.uniform2fv(at.sigma, DATA.sigma);
  const width = Number($("width").value);
  gl.uniform1f(at.least, 1.2 * devicePixelRatio * width);
  // points of some of the clouds lie farther apart than those of all
  const share = DATA.shares.reduce((sum, part, k) => sum + (clouds >> k & 1) * part, 0) || 1;
  gl.uniform1f(at.scale, 1.5 * width * view.pixels / Math.sqrt(share));
  gl.uniform2fv(at.heights, heights());
  gl.uniform4fv(at.cut, cutOf(view.eye));
  gl.uniform3i(at.clouds, DATA.clouds.length ? 1 + DATA.extras.indexOf("cloud") : 0, LAST_CLOUD, clouds);
  gl.uniform1i(at.bare, colour === "rgb" && !$("bare").checked ? 1 : 0);
  drawn.forEach((node, k) => {
    gl.uniform3fv(at.corner, minus(node.corner, view.eye));
    gl.uniform1f(at.size, node.size);
    gl.uniform1f(at.base, node.corner[2]);
    gl.uniform1fv(at["gaps[0]"], node.gaps);
    gl.uniform1ui(at.number, k);
    gl.bindVertexArray(node.buffers);
    gl.drawArrays(gl.POINTS, 0, node.n);
  });
  gl.bindVertexArray(null);
}

function resize() {
  const ratio = devicePixelRatio, width = Math.round(innerWidth * ratio), height = Math.round(innerHeight * ratio);
  if (targets && scene.width === width && scene.height === height) return;
  for (const canvas of [scene, marks]) Object.assign(canvas, { width, height });
  for (const each of Object.values(targets || {})) {
    gl.deleteFramebuffer(each.frame);
    gl.deleteTexture(each.image);
    gl.deleteTexture(each.depth);
  }
  targets = { colour: target(width, height, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE),
    number: target(width, height, gl.R32UI, gl.RED_INTEGER, gl.UNSIGNED_INT) };
}

function frame() {
  wanted = false;
  resize();
  const began = performance.now();
  const view = look(), { chosen, absent, points } = choose(view, still ? budget : MOST_BUDGET);
  drawn = chosen;
  for (const node of absent.slice(0, Math.max(0, AT_ONCE - loading))) load(node);
  for (const place of inside ? [inside, ...neighbours()] : [])
    if (place.state === "absent") readScript(place, `views/${encodeURIComponent(place.name)}.js`);
  gl.viewport(0, 0, scene.width, scene.height);
  gl.bindFramebuffer(gl.FRAMEBUFFER, targets.colour.frame);
  gl.enable(gl.DEPTH_TEST);
  gl.clearColor(0, 0, 0, 1);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  drawNodes(view, programs.points);
  if (track && $("track").checked) {
    gl.useProgram(programs.lines.made);
    gl.uniformMatrix4fv(programs.lines.at.project, false, view.project);
    gl.uniform3fv(programs.lines.at.corner, minus(DATA.corner, view.eye));
    gl.uniform3fv(programs.lines.at.tone, [0.835, 0.369, 0]);
    gl.bindVertexArray(track.vao);
    gl.drawArrays(gl.LINES, 0, track.n);
    gl.bindVertexArray(null);
  }
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.disable(gl.DEPTH_TEST);
  const { made, at } = programs.shade;
  gl.useProgram(made);
  [targets.colour.image, targets.colour.depth].forEach((texture, k) => {
    gl.activeTexture(gl.TEXTURE0 + k);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.uniform1i(k ? at.depth : at.image, k);
  });
  const sky = inside?.sky;
  gl.activeTexture(gl.TEXTURE2);
  gl.bindTexture(gl.TEXTURE_2D, sky || ramps);
  gl.uniform1i(at.sky, 2);
  gl.uniform1i(at.inside, sky ? 1 : 0);
  gl.uniform1f(at.cover, sky ? Number($("cover").value) : 1);
  if (sky) gl.uniform3fv(at["rays[0]"], [[view.right, view.half * scene.width / scene.height], [view.up, view.half],
    [view.back, -1]].flatMap(([axis, length]) => inside.axes.map((own) => length * dot(own, axis))));
  gl.uniform2f(at.planes, view.near, view.far);
  gl.uniform1f(at.strength, $("depth").checked ? 1.2 : 0);
  gl.uniform3fv(at.ground, dark() ? [0.078, 0.094, 0.11] : [0.957, 0.961, 0.965]);
  gl.drawArrays(gl.TRIANGLES, 0, 3);
  drawMarks(view);
  if (still) {  // moving: as many points as the machine draws at 30 frames a second; a pixel read waits for it
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    const ms = performance.now() - began;
    if (ms > 33) budget = Math.max(LEAST_BUDGET, Math.min(budget, points) * Math.max(0.5, 29 / ms));
    else if (ms < 20) budget = Math.min(MOST_BUDGET, budget * 1.1);
  }
  settled = !absent.length && !loading && !still && (!inside || "sky" in inside);
  const where = inside ? `${inside.name}, ${inside.utc} UTC, place ± ${Math.hypot(...inside.sigma).toFixed(3)} m · ` : "";
  if (!broken) $("state").textContent = `${where}${points.toLocaleString("en").replaceAll(",", "\u00a0")} points drawn${loading ? ", reading …" : ""}`;
  if (still) redraw();
}

let broken = false;
function say(words) {
  broken = true;
  $("state").textContent = words;
}

// ---------------------------------------------------------------- points under the mouse

let picked = [];

function pointAt(x, y) {  // CSS pixels -> node and number of the point nearest to them, or null
  const view = look(), ratio = devicePixelRatio, half = Math.round(6 * ratio);
  gl.bindFramebuffer(gl.FRAMEBUFFER, targets.number.frame);
  gl.viewport(0, 0, scene.width, scene.height);
  gl.enable(gl.DEPTH_TEST);
  gl.clearBufferuiv(gl.COLOR, 0, [0, 0, 0, 0]);
  gl.clear(gl.DEPTH_BUFFER_BIT);
  drawNodes(view, programs.numbers);
  const edge = 2 * half + 1, found = new Uint32Array(4 * edge * edge);
  const left = Math.round(x * ratio) - half, low = scene.height - 1 - Math.round(y * ratio) - half;
  gl.readPixels(left, low, edge, edge, gl.RGBA_INTEGER, gl.UNSIGNED_INT, found);
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  // of the points that show there, the one whose middle is nearest: discs of neighbours overlap
  let best = null, least = Infinity;
  for (const number of new Set(found.filter((value, k) => k % 4 === 0 && value))) {
    const point = { node: drawn[number - 1 >>> 18], k: number - 1 & 0x3ffff };
    const at = onScreen(placeOf(point.node, point.k), view);
    const away = at ? Math.hypot(at[0] - x, at[1] - y) : Infinity;
    if (away < least) [best, least] = [point, away];
  }
  return best;
}

function facts({ node, k }) {
  const part = (name, width = 1) => node[name] ? [...node[name].slice(width * k, width * k + width)] : null;
  const between = (name, share) => DATA.limits[name][0] + share * (DATA.limits[name][1] - DATA.limits[name][0]);
  return { place: placeOf(node, k), sigma: (part("sigma", 3) || [0, 0, 0]).map(sigmaOf), rgb: part("rgb", 3),
    coloured: part("coloured")?.[0] !== 0,
    range: node.range ? between("range", node.range[k] / 255) : null,
    intensity: node.intensity ? between("intensity", node.intensity[k] / 255) : null,
    extras: DATA.extras.map((name, e, { length }) => node.extra[length * k + e] && between(name, (node.extra[length * k + e] - 1) / 254)),
    photograph: node.image && node.image[k] ? DATA.photographs[node.image[k] - 1] : null,
    unix: node.time ? DATA.unix + between("time", node.time[k] / 65535) : null };
}
function onGrid(place) {
  const { middle, half, about, terms } = DATA.grid, [x, y, z] = minus(place, middle).map((d, i) => d / half[i]);
  const powers = [1, x, y, z, x * x, x * y, x * z, y * y, y * z, z * z];
  return terms.map((row, i) => about[i] + row.reduce((sum, factor, k) => sum + factor * powers[k], 0));
}
function volumes(corners, area) {  // between the points within a polygon and the plane that fits its corners best
  const middle = [0, 1, 2].map((i) => corners.reduce((sum, each) => sum + each[i], 0) / corners.length);
  let [xx, xy, yy, xz, yz] = [0, 0, 0, 0, 0];
  for (const each of corners) {
    const [x, y, z] = minus(each, middle);
    xx += x * x; xy += x * y; yy += y * y; xz += x * z; yz += y * z;
  }
  const whole = xx * yy - xy * xy;
  if (!(whole > 1e-9 * (xx + yy) ** 2)) return null;
  const [east, north] = [(xz * yy - yz * xy) / whole, (yz * xx - xz * xy) / whole];
  const within = (x, y) => corners.reduce((odd, [x1, y1], k) => {
    const [x2, y2] = corners[(k + 1) % corners.length];
    return y1 > y !== y2 > y && x < x1 + (y - y1) / (y2 - y1) * (x2 - x1) ? !odd : odd;
  }, false);
  // cells, a thousand of them, of the mean height above the plane: no sum of points, which lie denser near the boat
  const side = Math.sqrt(area / 1000), cells = new Map(), ends = [0, 1].map((i) => corners.map((each) => each[i]));
  const [[west, south], [right, top]] = [Math.min, Math.max].map((most) => ends.map((values) => most(...values)));
  for (let x = west + side / 2; x < right; x += side)
    for (let y = south + side / 2; y < top; y += side)
      if (within(x, y)) cells.set(`${Math.floor((x - west) / side)} ${Math.floor((y - south) / side)}`, [0, 0]);
  const [low, high] = heights(), of = DATA.extras.indexOf("cloud"), width = DATA.extras.length;
  for (const node of drawn)
    for (let k = 0; k < node.n; k++) {
      const [x, y, z] = placeOf(node, k), cell = cells.get(`${Math.floor((x - west) / side)} ${Math.floor((y - south) / side)}`);
      const shown = !DATA.clouds.length || clouds >> Math.round((node.extra[width * k + of] - 1) / 254 * LAST_CLOUD) & 1;
      if (!cell || z < low || z > high || !shown) continue;
      cell[0] += z - middle[2] - east * (x - middle[0]) - north * (y - middle[1]);
      cell[1]++;
    }
  const means = [...cells.values()].filter(([, n]) => n).map(([sum, n]) => sum / n);
  const sum = (sign) => side * side * means.reduce((all, mean) => all + Math.max(sign * mean, 0), 0);
  return { above: sum(1), below: sum(-1), share: means.length / Math.max(cells.size, 1) };
}
const withSigma = (value, sigma) => `${value.toFixed(3)} m${isFinite(sigma) ? ` ± ${sigma.toFixed(3)} m` : ""}`;

function report() {
  const lines = [], names = ["east", "north", "up"];
  if (picked.length === 1) {
    const [point] = picked;
    names.forEach((name, k) => lines.push(`${name} ${withSigma(point.place[k], point.sigma[k])}`));
    if (DATA.grid) {
      // grid north differs from that of the frame by a degree or two: the standard deviations hold for both
      const [east, north, height] = onGrid(point.place).map((x, k) => withSigma(x, point.sigma[k]));
      lines.push(`${DATA.grid.name}:`, `  easting ${east}`, `  northing ${north}`, `  ellipsoidal height ${height}`);
    }
    if (point.range !== null) lines.push(`range ${point.range.toFixed(1)} m`);
    if (point.intensity !== null) lines.push(`intensity ${Math.round(point.intensity)}`);
    if (point.unix !== null) lines.push(`time ${new Date(1000 * point.unix).toISOString().slice(0, 21).replace("T", " ")} UTC`);
    point.extras.forEach((value, e) => value !== 0 && lines.push(`${DATA.extras[e]} ${
      DATA.extras[e] === "cloud" && DATA.clouds[Math.round(value) - 1] || `${Number(value.toPrecision(3))} ${DATA.units[DATA.extras[e]]}`}`));
    if (point.rgb) lines.push(point.coloured ? `colour ${point.rgb.join(" ")}` : "no photograph shows it");
  } else if (picked.length === 2) {
    const [a, b] = picked, d = minus(b.place, a.place), s = [0, 1, 2].map((k) => Math.hypot(a.sigma[k], b.sigma[k]));
    const along = (parts) => {
      const length = Math.hypot(...parts.map((k) => d[k]));
      return withSigma(length, Math.hypot(...parts.map((k) => d[k] * s[k])) / length);
    };
    picked.forEach((point, i) => lines.push(`${i + 1}: ${point.place.map((x) => x.toFixed(3)).join("  ")}`));
    lines.push(`distance ${along([0, 1, 2])}`, `level distance ${along([0, 1])}`,
      `height difference ${withSigma(d[2], s[2])}`);
  }
  if (picked.length > 2) {  // a line, and the level area within it when it is closed
    const places = picked.map(({ place }) => minus(place, picked[0].place)), n = places.length;
    let length = 0, area = 0, variance = 0;
    places.forEach(([x, y], k) => {
      const [after, before] = [places[(k + 1) % n], places[(k + n - 1) % n]], { sigma } = picked[k];
      if (k) length += Math.hypot(...minus(places[k], before));
      area += (x * after[1] - after[0] * y) / 2;
      variance += ((after[1] - before[1]) * sigma[0]) ** 2 / 4 + ((after[0] - before[0]) * sigma[1]) ** 2 / 4;
    });
    const within = isFinite(variance) ? ` ± ${Math.sqrt(variance).toFixed(2)} m²` : "";
    lines.push(`${n} points`, `length of the line ${length.toFixed(3)} m`, `level area ${Math.abs(area).toFixed(2)} m²${within}`);
    const found = volumes(picked.map(({ place }) => place), Math.abs(area));
    if (found) lines.push("heights above the plane through the points:", `  volume above it ${found.above.toFixed(2)} m³`,
      `  volume below it ${found.below.toFixed(2)} m³`, `  from ${Math.round(100 * found.share)} % of the area, the rest holds no points`);
  }
  if (picked.length && isFinite(picked[0].sigma[0]))
    lines.push(`± one standard deviation${picked.length > 1 ? ", errors of all points as independent" : ""}`);
  $("found").textContent = lines.join("\n");
  if (picked.length !== 1) return;
  const link = (words, href) => {
    const made = document.createElement("a");
    Object.assign(made, { textContent: words, href, target: "_blank" });
    $("found").append("\n", made);
  };
  const { place, photograph } = picked[0], towards = `towards=${digits(place, 3)}`;
  if (photograph) link(`photograph ${photograph[0]}`, photograph[1]);
  if (photograph?.[2] && !places.length) link("panorama of its time", `${photograph[2]}&${towards}`);
  if (places.length) {
    const nearest = nearestPlace(place);
    link(`from panorama ${nearest.name}`, `#panorama=${encodeURIComponent(nearest.name)}&${towards}`);
    $("found").lastChild.target = "";
  }
}

function drawMarks(view) {
  const pen = marks.getContext("2d"), ratio = devicePixelRatio;
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, innerWidth, innerHeight);
  const places = picked.map((point) => onScreen(point.place, view));
  pen.strokeStyle = pen.fillStyle = dark() ? "#fff" : "#000";
  pen.lineWidth = 1.5;
  pen.font = "13px system-ui, sans-serif";
  if (places.length > 1 && places.every((place) => place)) {
    pen.beginPath();
    for (const place of places) pen.lineTo(...place);
    if (places.length > 2) pen.closePath();
    pen.stroke();
  }
  places.forEach((place, k) => {
    if (!place) return;
    pen.beginPath(); pen.arc(...place, 6, 0, 7); pen.stroke();
    if (places.length > 1) pen.fillText(String(k + 1), place[0] + 9, place[1] - 7);
  });
  drawWalk(view, pen);
  if (inside) return;
  // a length at the distance of the point that the view turns about, and north
  const metres = camera.far * 2 * HALF_VIEW / innerHeight * 160, power = 10 ** Math.floor(Math.log10(metres));
  const length = power * [5, 2, 1].find((step) => step * power <= metres), px = 160 * length / metres;
  const [x, y] = [innerWidth - 30, 24];
  pen.beginPath(); pen.moveTo(x - px, y - 5); pen.lineTo(x - px, y); pen.lineTo(x, y); pen.lineTo(x, y - 5); pen.stroke();
  pen.textAlign = "right";
  pen.fillText(`${length} m`, x, y + 16);
  const [right, up] = axes(), north = [right[1], -up[1]], [cx, cy] = [x - 20, y + 66];
  pen.beginPath(); pen.moveTo(cx, cy); pen.lineTo(cx + 22 * north[0], cy + 22 * north[1]); pen.stroke();
  pen.textAlign = "center";
  pen.fillText("N", cx + 31 * north[0], cy + 31 * north[1] + 4);
  pen.textAlign = "left";
}

// ---------------------------------------------------------------- panoramas

function nearestPlace(point) {
  const away = (place) => Math.hypot(...minus(place.at, point));
  return places.reduce((best, place) => away(place) < away(best) ? place : best);
}
const neighbours = () => [-1, 1].map((step) => places[places.indexOf(inside) + step]).filter((place) => place);
function lookTo(direction) {
  camera.turn = (Math.atan2(direction[0], direction[1]) * 180 / Math.PI + 360) % 360;
  camera.tilt = -Math.atan2(direction[2], Math.hypot(direction[0], direction[1])) * 180 / Math.PI;
}
function enter(place) {
  if (!place) return;
  inside = place;
  for (const other of places)  // a picture of 4096 px takes 32 MB of the graphics card
    if (other.sky && Math.abs(places.indexOf(other) - places.indexOf(place)) > 2) {
      gl.deleteTexture(other.sky);
      delete other.sky;
      other.state = "absent";
    }
  moved();
}
function leave() {
  if (inside) [camera.at, camera.far, inside] = [[...inside.at], Math.min(camera.far, 40), null];
  else if (places.length) return enter(nearestPlace(camera.at));
  moved();
}
const step = (n) => enter(inside ? places[places.indexOf(inside) + n] : places.length && nearestPlace(camera.at));

async function thalwegPanorama(name, letters) {
  const place = places.find((each) => each.name === name);
  const picture = await createImageBitmap(new Blob([bytesOf(letters)], { type: "image/jpeg" }));
  place.sky = gl.createTexture();
  gl.activeTexture(gl.TEXTURE2);
  gl.bindTexture(gl.TEXTURE_2D, place.sky);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, gl.RGB, gl.UNSIGNED_BYTE, picture);
  picture.close();
  for (const key of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, key, gl.LINEAR);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
  place.state = "here";
  loading--;
  redraw();
}

function mapped() {  // metres -> pixels of the map, north up
  const ends = [0, 1].map((axis) => places.map((place) => place.at[axis])).map((x) => [Math.min(...x), Math.max(...x)]);
  const scale = ($("map").clientWidth - 30) / Math.max(10, ...ends.map(([low, high]) => high - low));
  const middle = ends.map(([low, high]) => (low + high) / 2), half = $("map").clientWidth / 2;
  return ([east, north]) => [half + scale * (east - middle[0]), half - scale * (north - middle[1])];
}

function drawWalk(view, pen) {  // arrows to the next ones, places seen from outside, and the map
  if (!places.length) return;
  for (const [id, n] of [["before", -1], ["after", 1]]) {
    const other = inside && places[places.indexOf(inside) + n];
    const d = other && minus(other.at, inside.at), length = d && Math.hypot(d[0], d[1]);
    const at = length && onScreen(inside.at.map((x, i) => x + (i < 2 ? 3 * d[i] / length : -0.9)), view);
    $(id).hidden = !at || at[0] < 0 || at[0] > innerWidth || at[1] < 0 || at[1] > innerHeight;
    if ($(id).hidden) continue;
    $(id).textContent = `▲ ${length.toFixed(1)} m`;
    $(id).style.translate = `calc(${at[0]}px - 50%) calc(${at[1]}px - 50%)`;
  }
  if (!inside)
    for (const place of places) {
      const at = onScreen(place.at, view);
      if (at) { pen.beginPath(); pen.arc(...at, 3, 0, 7); pen.fill(); }
    }
  const map = $("map"), ratio = devicePixelRatio, width = map.clientWidth, at = mapped();
  if (map.width !== width * ratio) map.width = map.height = width * ratio;
  const ink = map.getContext("2d");
  ink.setTransform(ratio, 0, 0, ratio, 0, 0);
  ink.clearRect(0, 0, width, width);
  ink.strokeStyle = "#888";
  ink.beginPath();
  DATA.track.forEach((place, k) => place && (DATA.track[k - 1] ? ink.lineTo(...at(place)) : ink.moveTo(...at(place))));
  ink.stroke();
  ink.fillStyle = dark() ? "#fff" : "#000";
  for (const place of places) { ink.beginPath(); ink.arc(...at(place.at), 2.5, 0, 7); ink.fill(); }
  ink.fillText("N ↑", 6, 14);
  if (!inside) return;
  const [x, y] = at(inside.at), turned = (camera.turn - 90) * Math.PI / 180, half = Math.atan(view.half * innerWidth / innerHeight);
  ink.fillStyle = "#d55e0099";
  ink.beginPath(); ink.moveTo(x, y); ink.arc(x, y, 34, turned - half, turned + half); ink.fill();
  ink.fillStyle = "#d55e00";
  ink.beginPath(); ink.arc(x, y, 4.5, 0, 7); ink.fill();
}

// ---------------------------------------------------------------- hands

const dark = () => document.documentElement.dataset.theme === "dark";
function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  redraw();
}
function setClouds(bits) {
  clouds = bits;
  [...document.getElementsByName("cloud")].forEach((each, k) => { each.checked = bits >> k & 1; });
}
function setColour(name) {
  if (name === "cloud" && colour !== name) setClouds(EACH_CLOUD);
  colour = name;
  for (const each of document.getElementsByName("colour")) each.checked = each.value === name;
  $("legend").hidden = name === "rgb" || name === "cloud";
  if (name !== "rgb") {
    const pen = $("ramp").getContext("2d"), image = pen.createImageData(256, 1), bytes = atob(DATA.ramps[name]);
    for (let k = 0; k < 256; k++) image.data.set([...[0, 1, 2].map((i) => bytes.charCodeAt(3 * k + i)), 255], 4 * k);
    pen.putImageData(image, 0, 0);
    const text = (x) => `${Math.abs(x) >= 100 ? x.toFixed(0) : Number(x.toPrecision(3))} ${DATA.units[name]}`.replace("-", "−");
    const [low, high] = DATA.limits[name];
    $("low").textContent = text(low);
    $("high").textContent = text(high) + (name === "sigma" ? " (log)" : name === "time" ? " after the first" : "");
  }
  writeHash();
  redraw();
}

function listen() {
  const fingers = new Map();
  let travelled = 0, lastGap = 0;
  scene.addEventListener("pointerdown", (event) => {
    scene.setPointerCapture(event.pointerId);
    scene.focus();
    if (!fingers.size) travelled = 0;
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    lastGap = 0;
  });
  scene.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before) return;
    const [dx, dy] = [event.clientX - before[0], event.clientY - before[1]];
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    travelled += Math.abs(dx) + Math.abs(dy);
    if (travelled < 4) return;
    if (fingers.size === 2) {
      const [a, b] = [...fingers.values()], gap = Math.hypot(a[0] - b[0], a[1] - b[1]);
      if (lastGap) zoom(lastGap / gap);
      lastGap = gap;
      move(dx / 2, dy / 2);
    } else if (event.buttons & 6 || event.shiftKey) move(dx, dy);
    else turn(...[dx, dy].map((x) => x * (inside ? camera.open / innerHeight : 0.3)));
  });
  scene.addEventListener("pointerup", (event) => {
    fingers.delete(event.pointerId);
    if (travelled >= 4 || event.button || fingers.size) return;
    const point = pointAt(event.clientX, event.clientY);
    if (point) picked = [...(picked.length < 2 || event.shiftKey ? picked : []), facts(point)];
    report();
    redraw();
  });
  scene.addEventListener("pointercancel", (event) => fingers.delete(event.pointerId));
  scene.addEventListener("dblclick", (event) => {
    const point = pointAt(event.clientX, event.clientY);
    picked = [];
    report();
    if (point && inside) lookTo(minus(facts(point).place, inside.at));
    else if (point) { camera.at = facts(point).place; camera.far /= 1.6; }
    if (point) moved();
  });
  scene.addEventListener("contextmenu", (event) => event.preventDefault());
  scene.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(Math.max(-100, Math.min(100, event.deltaY)) * 0.0015));
  }, { passive: false });
  const keys = { ArrowLeft: () => turn(5, 0), ArrowRight: () => turn(-5, 0), ArrowUp: () => turn(0, 5),
    ArrowDown: () => turn(0, -5), "+": () => zoom(0.87), "=": () => zoom(0.87), "-": () => zoom(1.15),
    w: () => move(0, 40), s: () => move(0, -40), a: () => move(40, 0), d: () => move(-40, 0), r: () => home(),
    t: () => home({ turn: 0, tilt: 90 }), l: () => setTheme(dark() ? "light" : "dark"),
    c: toggleCut, n: () => step(1), p: () => step(-1), i: leave,
    Escape: () => { picked = []; report(); redraw(); } };
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.matches("input, summary")) return;
    const name = COLOURS[Number(event.key) - 1];
    const act = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (usable(name)) setColour(name);
    else if (act) { act(); event.preventDefault(); }
  });
  for (const name of COLOURS.filter(usable)) {
    const label = document.createElement("label"), input = document.createElement("input");
    Object.assign(input, { type: "radio", name: "colour", value: name, onchange: () => setColour(name) });
    label.append(input, ` ${WORDS[name] || name}`);
    $("colours").append(label);
  }
  DATA.clouds.forEach((name, k) => {
    const label = document.createElement("label"), input = document.createElement("input"), tone = document.createElement("b");
    Object.assign(input, { type: "checkbox", name: "cloud", onchange: () => { setClouds(clouds ^ 1 << k); writeHash(); redraw(); } });
    const at = 3 * Math.round(255 * k / LAST_CLOUD), bytes = atob(DATA.ramps.cloud);
    tone.style.color = `rgb(${[0, 1, 2].map((i) => bytes.charCodeAt(at + i))})`;
    tone.textContent = " ● ";
    label.append(input, tone, name);
    $("clouds").append(label);
  });
  $("clouds").hidden = !DATA.clouds.length;
  setClouds(clouds);
  for (const id of ["width", "depth", "track", "bare", "cover"]) $(id).addEventListener("input", redraw);
  for (const id of ["lowest", "highest"]) $(id).addEventListener("input", moved);
  for (const each of ["map", "walk", "over", "walking"]) $(each).hidden = !places.length;
  const acts = { cut: toggleCut, before: () => step(-1), after: () => step(1), previous: () => step(-1), next: () => step(1), leave };
  for (const id in acts) $(id).onclick = acts[id];
  $("map").onclick = (event) => {
    const at = mapped(), away = ({ at: place }) => Math.hypot(...minus(at(place), [event.offsetX, event.offsetY]));
    enter(places.reduce((best, place) => away(place) < away(best) ? place : best));
  };
  $("path").hidden = !track;
  $("grey").hidden = !columns.coloured;
  $("home").onclick = () => home();
  $("top").onclick = () => home({ turn: 0, tilt: 90 });
  $("theme").onclick = keys.l;
  addEventListener("resize", redraw);
  addEventListener("hashchange", () => { readHash(); setClouds(clouds); enter(inside); setColour(colour); });
}

if (!gl) say("This browser offers no WebGL 2: use a current Firefox, Chrome, Edge or Safari, with graphics acceleration.");
else {
  start();
  readHash();
  listen();
  $("panel").open = innerWidth > 600;
  setTheme(matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light");
  setColour(colour);
}
