"use strict";
// Shows the pictures that come over a socket, and sends mouse, keys and fingers back. Messages: page_messages.py.

const get = (id) => document.getElementById(id);
const stage = get("stage"), picture = get("picture"), strokes = get("strokes");
const RETRY = 1500;  // [ms] between attempts to connect again
const RESIZE_DELAY = 150;  // [ms] without a change of the page's size before the picture follows
const PIXELS_PER_NOTCH = 100;  // of a wheel
const PINCH_PER_NOTCH = 1.1;  // of the fingers' distance
const HINT_SECONDS = 20;
const SLIDERS = [  // name, label, unit, low, high, step; places are relative to the scene's target
  ["x", "x", "m", null, null, 0.01], ["y", "y", "m", null, null, 0.01], ["z", "z", "m", null, null, 0.01],
  ["strength", "shadow", "", 0, 1, 0.01], ["softness", "edge", "m", 0, 0.2, 0.001],
];

let socket = null, hello = null, ended = "";
let state = {};  // what the program has told
let waiting = Promise.resolve();  // pictures are shown in the order in which they come
let shape = { width: 16, height: 9 };  // of the last picture
let marks = [];

// ---------------------------------------------------------------- the socket

function connect() {
  const url = new URL("socket", location.href);
  url.protocol = location.protocol === "https:" ? "wss:" : "ws:";
  url.search = location.search;
  socket = new WebSocket(url);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => { ended = ""; sendSize(); send("hidden", document.hidden); send("details", get("performance").open && !get("panel").hidden); };
  socket.onmessage = (event) => typeof event.data === "string" ? take(JSON.parse(event.data)) : arrive(event.data);
  socket.onclose = (event) => {
    state = {};
    get("role").hidden = get("line").hidden = true;
    if (event.code === 1001) ended = "The play has ended.";
    say(ended || (hello ? "The connection is lost. Trying again …" : "No answer. Trying again …"));
    setTimeout(connect, RETRY);
  };
}

function send(...message) {
  if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

function say(text) {
  get("loading").textContent = text;
  get("loading").hidden = !text;
}

// ---------------------------------------------------------------- pictures

function arrive(data) {
  const length = new DataView(data).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
  const jpeg = new Blob([new Uint8Array(data, 4 + length)], { type: "image/jpeg" });
  waiting = waiting.then(() => createImageBitmap(jpeg)).then((bitmap) => show(bitmap, head));
}

function show(bitmap, head) {
  if (picture.width !== bitmap.width || picture.height !== bitmap.height) {
    picture.width = bitmap.width;
    picture.height = bitmap.height;
    shape = { width: bitmap.width, height: bitmap.height };
    place();
  }
  picture.getContext("2d", { alpha: false }).drawImage(bitmap, 0, 0);
  bitmap.close();
  marks = head.overlay;
  drawStrokes();
  send("shown", head.n, head.stamp === null ? null : Math.max(0, performance.now() - head.stamp));
}

function frame() {  // rectangle of the picture in the page: as large as its shape allows
  const scale = Math.min(innerWidth / shape.width, innerHeight / shape.height);
  const width = shape.width * scale, height = shape.height * scale;
  const close = Math.abs(width - innerWidth) < 0.02 * innerWidth && Math.abs(height - innerHeight) < 0.02 * innerHeight;
  if (close) return { left: 0, top: 0, width: innerWidth, height: innerHeight };  // sides are rounded to pixels
  return { left: (innerWidth - width) / 2, top: (innerHeight - height) / 2, width, height };
}

function place() {
  const at = frame();
  for (const canvas of [picture, strokes]) {
    Object.assign(canvas.style, { left: `${at.left}px`, top: `${at.top}px`, width: `${at.width}px`, height: `${at.height}px` });
  }
  strokes.width = Math.round(at.width * devicePixelRatio);
  strokes.height = Math.round(at.height * devicePixelRatio);
  drawStrokes();
}

function drawStrokes() {
  const context = strokes.getContext("2d"), { width, height } = strokes, unit = devicePixelRatio;
  context.clearRect(0, 0, width, height);
  for (const [colour, thickness] of [["rgba(0, 0, 0, .4)", 4], [null, 2]]) {
    context.lineWidth = thickness * unit;
    for (const mark of marks) {
      context.beginPath();
      if (mark.length === 2) {
        context.strokeStyle = colour || "#faa83d";
        context.arc(mark[0] * width, mark[1] * height, 9 * unit, 0, 2 * Math.PI);
      } else {
        context.globalAlpha = mark[4];
        context.strokeStyle = colour || "#fff5db";
        context.moveTo(mark[0] * width, mark[1] * height);
        context.lineTo(mark[2] * width, mark[3] * height);
      }
      context.stroke();
      context.globalAlpha = 1;
    }
  }
}

let resizing = 0;
function sendSize() {
  send("size", Math.max(1, Math.round(innerWidth * devicePixelRatio)), Math.max(1, Math.round(innerHeight * devicePixelRatio)));
}
addEventListener("resize", () => {
  place();
  clearTimeout(resizing);
  resizing = setTimeout(sendSize, RESIZE_DELAY);
});
document.addEventListener("visibilitychange", () => send("hidden", document.hidden));

// ---------------------------------------------------------------- mouse and fingers

const fingers = new Map();  // pointers that are down: id -> {x, y}
const BUTTONS = ["left", "middle", "right"];
let pinch = null;  // distance and middle of two fingers
let moved = null;  // the last move that is not sent yet

function fraction(x, y) {
  const at = frame(), bound = (value) => Math.max(-4, Math.min(4, value));
  return [bound((x - at.left) / at.width), bound((y - at.top) / at.height)];
}

function flush() {  // one move a frame of the screen is enough; before anything else it goes out at once
  if (moved) send("move", ...fraction(moved.x, moved.y), moved.time);
  moved = null;
}

function two() {
  const [a, b] = [...fingers.values()];
  return { distance: Math.max(1, Math.hypot(a.x - b.x, a.y - b.y)), x: (a.x + b.x) / 2, y: (a.y + b.y) / 2 };
}

stage.addEventListener("pointerdown", (event) => {
  event.preventDefault();
  stage.focus();
  stage.setPointerCapture(event.pointerId);
  fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  flush();
  if (event.pointerType !== "mouse" && fingers.size === 2) pinch = two();
  if (fingers.size === 1) {
    send("button", BUTTONS[event.button] || "left", true, ...fraction(event.clientX, event.clientY), event.timeStamp);
  }
});

stage.addEventListener("pointermove", (event) => {
  if (fingers.has(event.pointerId)) fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  if (pinch && fingers.size === 2) {
    const now = two(), notches = Math.log(now.distance / pinch.distance) / Math.log(PINCH_PER_NOTCH);
    const shift = [(now.x - pinch.x) / frame().width, (now.y - pinch.y) / frame().height];
    pinch = now;
    send("pinch", Math.max(-50, Math.min(50, notches)), ...shift, event.timeStamp);
  }
  if (pinch && event.pointerId !== fingers.keys().next().value) return;  // the first finger holds
  if (!moved) requestAnimationFrame(flush);
  moved = { x: event.clientX, y: event.clientY, time: moved ? moved.time : event.timeStamp };
});

for (const kind of ["pointerup", "pointercancel"]) {
  stage.addEventListener(kind, (event) => {
    const first = event.pointerId === fingers.keys().next().value;
    fingers.delete(event.pointerId);
    flush();
    if (first) {
      const button = event.pointerType === "mouse" ? BUTTONS[event.button] || "left" : "left";
      send("button", button, false, ...fraction(event.clientX, event.clientY), event.timeStamp);
    }
    if (fingers.size < 2) pinch = null;
    if (pinch === null && event.pointerType !== "mouse" && first) fingers.clear();  // the other one begins anew
  });
}
stage.addEventListener("contextmenu", (event) => event.preventDefault());
stage.addEventListener("wheel", (event) => {
  event.preventDefault();
  const lines = event.deltaMode === 0 ? event.deltaY / PIXELS_PER_NOTCH : event.deltaY / 3;
  send("wheel", Math.max(-50, Math.min(50, -lines)), event.timeStamp);
}, { passive: false });

// ---------------------------------------------------------------- keys

const LEFT_ALONE = ["F5", "F11", "F12", "Tab"];  // the browser's own

function key(event, down) {
  const writing = /^(SELECT|TEXTAREA)$/.test(event.target.tagName);
  const ctrl = event.ctrlKey || event.metaKey;
  if (event.code === "F1") {
    event.preventDefault();
    if (down && !event.repeat) togglePanel();
    return;
  }
  const pressing = /^(BUTTON|SUMMARY)$/.test(event.target.tagName) && ["Space", "Enter"].includes(event.code);
  const sliding = event.target.type === "range" && event.key.startsWith("Arrow");
  if (writing || pressing || sliding || LEFT_ALONE.includes(event.key) || !hello) return;
  if (ctrl && event.key !== "Control" && !hello.ctrl_keys.includes(event.key.toLowerCase())) return;
  event.preventDefault();
  if (!event.repeat && event.code.length <= 40 && event.key.length <= 40) {
    flush();
    send("key", event.code, event.key, down, ctrl, event.timeStamp);
  }
}
addEventListener("keydown", (event) => key(event, true));
addEventListener("keyup", (event) => key(event, false));
addEventListener("blur", () => { fingers.clear(); pinch = null; send("blur"); });

// ---------------------------------------------------------------- the panel

const command = (name, value) => send("command", { [name]: value });

function button(name, tip, act) {
  const made = document.createElement("button");
  made.textContent = name;
  made.title = tip || "";
  made.onclick = act;
  return made;
}

function choice(id, names, act) {
  get(id).replaceChildren(...names.map((name) => button(name, names.tips && names.tips[name], () => act(name))));
}

function mark(id, chosen) {
  for (const one of get(id).children) one.classList.toggle("on", one.textContent === chosen);
}

function rows(id, lines) {
  get(id).replaceChildren(...lines.map((line) => {
    const row = document.createElement("tr");
    row.append(...line.map((text) => Object.assign(document.createElement("td"), { textContent: text })));
    return row;
  }));
}

function togglePanel() {
  get("panel").hidden = !get("panel").hidden;
  get("menu").classList.toggle("on", !get("panel").hidden);
  document.body.classList.toggle("open", !get("panel").hidden);
  send("details", get("performance").open && !get("panel").hidden);
  if (get("panel").hidden) send("edits", false);
}

function build() {
  document.title = hello.title;
  get("cast").textContent = hello.cast.join("; ");
  choice("interaction", Object.assign(Object.keys(hello.interactions), { tips: hello.interactions }),
    (name) => command("interaction", name.toLowerCase()));
  choice("light-kind", ["Point", "Directional"], (name) => setLight({ kind: name.toLowerCase() }));
  choice("resolution", hello.resolutions, (name) => { send("resolution", name); mark("resolution", name); });
  get("edits").replaceChildren(...Object.entries(hello.edits).map(([name, tip]) => button(name, tip, () => send("edit", name))));
  get("material").replaceChildren(new Option("Material", ""), ...hello.materials.map((name) => new Option(name, name)));
  get("sliders").replaceChildren(...SLIDERS.map(([name, label, unit, low, high, step]) => {
    const axis = "xyz".indexOf(name), row = document.createElement("label");
    const input = Object.assign(document.createElement("input"), { type: "range", id: `light-${name}`, step });
    input.min = axis < 0 ? low : hello.light_centre[axis] - hello.light_range;
    input.max = axis < 0 ? high : hello.light_centre[axis] + hello.light_range;
    input.oninput = () => { slide(); showSlider(name, unit); };
    const text = Object.assign(document.createElement("span"), { textContent: label, className: "quiet" });
    row.append(text, input, Object.assign(document.createElement("output"), { id: `value-${name}` }));
    return row;
  }));
  const touch = matchMedia("(pointer: coarse)").matches;
  const gestures = touch ? [["One finger", "grab a body, release to throw; else turn around the scene"],
    ["Two fingers", "apart or together: nearer and farther; side by side: shift the view"],
    ["  while holding", "the body comes nearer or goes farther"]] : [];
  rows("key-list", [...gestures, ...hello.keys]);
  const bold = (text) => Object.assign(document.createElement("b"), { textContent: text });
  const hint = get("hint");
  hint.replaceChildren(bold("Drag"), " a body to grab it, let go to throw   ·   ", bold(touch ? "≡" : "F1"), " panel");
  if (!touch) hint.append("   ·   ", bold("P"), " demonstration");
}

function showSlider(name, unit) {
  const value = Number(get(`light-${name}`).value);
  get(`value-${name}`).textContent = name === "softness" ? `${(100 * value).toFixed(1)} cm` : `${value.toFixed(2)} ${unit}`;
}

function setLight(change) {
  if (state.light) command("light", { Light: { ...state.light, ...change } });
}

function slide() {  // all of the sliders: the last of several changes in a frame counts
  const value = (name) => Number(get(`light-${name}`).value);
  setLight({ position: ["x", "y", "z"].map(value), strength: value("strength"), softness: value("softness") });
}

get("menu").onclick = togglePanel;
get("take").onclick = () => send("take");
get("pause").onclick = () => command("pause", !state.paused);
get("step").onclick = () => { command("pause", true); command("step", true); };
get("reset").onclick = () => command("reset", true);
get("undo").onclick = () => command("undo", true);
get("redo").onclick = () => command("redo", true);
get("demo").onclick = () => command("demo", !state.demo);
get("material").onchange = (event) => {
  if (event.target.value) command("material", [null, event.target.value]);
  event.target.value = "";
  stage.focus();
};
get("performance").ontoggle = () => send("details", get("performance").open && !get("panel").hidden);
get("edit").onpointerenter = () => send("edits", true);
get("edit").onpointerleave = () => send("edits", false);
get("panel").addEventListener("click", (event) => {
  if (event.target.tagName === "BUTTON" && event.detail) stage.focus();  // a click, not a key: keys play on
});

// ---------------------------------------------------------------- what the program tells

function take(news) {
  if ("ping" in news) send("pong", news.ping);
  if ("title" in news) { hello = news; build(); }
  if ("overlay" in news) { marks = news.overlay; drawStrokes(); }
  Object.assign(state, news);
  if ("loading" in news) say(news.loading);
  if ("role" in news || "pages" in news) showRole();
  if ("message" in news || "score" in news || "notice" in news) {
    get("score").textContent = state.score;
    get("message").textContent = state.message;
    get("notice").textContent = state.notice;
    get("line").hidden = !(state.score || state.message || state.notice);
  }
  if ("editable" in news) {
    get("play").hidden = get("edit").hidden = !state.editable;
    get("hint").hidden = !state.editable || state.role !== "play" || get("hint").classList.contains("gone");
    setTimeout(() => get("hint").classList.add("gone"), HINT_SECONDS * 1000);
  }
  if ("paused" in news) get("pause").textContent = state.paused ? "Resume" : "Pause";
  if ("demo" in news) get("demo").textContent = state.demo ? "Stop" : "Watch";
  if ("demo" in news) get("demo").classList.toggle("on", state.demo);
  if ("interaction" in news) mark("interaction", state.interaction);
  if ("selected" in news) {
    get("selected").textContent = state.selected || "Take hold of a body to change it.";
    get("selected").classList.toggle("quiet", !state.selected);
    get("material").hidden = get("edits").hidden = !state.selected;
  }
  if ("light" in news) showLight();
  if ("fps" in news) get("fps").textContent = state.fps === null ? "at rest" : `${state.fps} fps`;
  if ("resolution" in news) mark("resolution", state.resolution);
  if ("stages" in news) rows("stages", [["ms", "median", "worst"], ...state.stages]);
  if ("lines" in news || "counts" in news) get("numbers").textContent = [...(state.lines || []), (state.counts || []).join(", ")].join("\n");
  if ("grabbing" in news) {
    stage.classList.toggle("grabbing", state.grabbing);
    if (state.grabbing) get("hint").classList.add("gone");
  }
}

function showLight() {
  get("light").hidden = !state.light;
  if (!state.light) return;
  mark("light-kind", state.light.kind === "point" ? "Point" : "Directional");
  const values = { strength: state.light.strength, softness: state.light.softness };
  state.light.position.forEach((value, axis) => { values["xyz"[axis]] = value; });
  for (const [name, , unit] of SLIDERS) {
    const input = get(`light-${name}`);
    if (!input.matches(":active")) input.value = values[name];
    showSlider(name, unit);
  }
}

function showRole() {
  const watching = state.role === "watch", others = state.pages - 1;
  get("controls").disabled = watching;
  get("role").hidden = !watching;
  get("role-text").textContent = "You are watching: another page plays.";
  stage.title = !watching && others ? `${others} ${others === 1 ? "page watches" : "pages watch"}` : "";
}

place();
connect();
get("light").open = innerWidth >= 900 && innerHeight >= 700;  // all of the panel is to be seen
if (innerWidth >= 900) togglePanel();
