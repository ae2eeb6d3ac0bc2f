"use strict";
// Shows the pictures that come over a socket, and sends mouse, keys and fingers back. Messages: page_messages.py.

const get = (id) => document.getElementById(id);
const stage = get("stage"), picture = get("picture"), strokes = get("strokes");
const RETRY = 1500;  // [ms] between attempts to connect again
const RESIZE_DELAY = 150;  // [ms] without a change of the page's size before the picture follows
const PIXELS_PER_NOTCH = 100;  // of a wheel
const PINCH_PER_NOTCH = 1.1;  // of the fingers' distance
const HINT_SECONDS = 20;
const PANEL_ROUNDING = 14;  // [px] of its corners, under which the picture goes on
const SLIDER_STEPS = 1000;

let socket = null, hello = null, ended = "";
let state = {};  // what the program has told
let waiting = Promise.resolve();  // pictures are shown in the order in which they come
let shape = [16, 9];  // of the last picture: width and height, in any unit
let marks = [];

// ---------------------------------------------------------------- the socket

function connect() {
  const url = new URL("socket", location.href);
  url.protocol = location.protocol === "https:" ? "wss:" : "ws:";
  url.search = location.search;
  socket = new WebSocket(url);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => { ended = ""; sendSize(); send("hidden", document.hidden); sendDetails(); };
  socket.onmessage = (event) => typeof event.data === "string" ? take(JSON.parse(event.data)) : arrive(event.data);
  socket.onclose = (event) => {
    state = {};
    get("controls").hidden = true;
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
  }
  if (String(shape) !== String(head.shape)) {
    shape = head.shape;
    place();
  }
  picture.getContext("2d", { alpha: false }).drawImage(bitmap, 0, 0);
  bitmap.close();
  marks = head.overlay;
  drawStrokes();
  send("shown", head.n, head.stamp === null ? null : Math.max(0, performance.now() - head.stamp));
}

function area() {  // what the page has for the picture [px]: on a telephone, what the panel leaves
  const panel = get("panel");
  const below = !panel.hidden && matchMedia("(max-width: 560px)").matches;
  return { width: innerWidth, height: innerHeight - (below ? panel.offsetHeight - PANEL_ROUNDING : 0) };
}

function frame() {  // rectangle of the picture in the page: as large as its shape allows
  const { width: wide, height: high } = area();
  const scale = Math.min(wide / shape[0], high / shape[1]);
  const width = shape[0] * scale, height = shape[1] * scale;
  const close = Math.abs(width - wide) < 0.02 * wide && Math.abs(height - high) < 0.02 * high;
  if (close) return { left: 0, top: 0, width: wide, height: high };  // sides are rounded to pixels
  return { left: (wide - width) / 2, top: (high - height) / 2, width, height };
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
  const { width, height } = area();
  send("size", Math.max(1, Math.round(width * devicePixelRatio)), Math.max(1, Math.round(height * devicePixelRatio)));
}
function resize() {
  place();
  clearTimeout(resizing);
  resizing = setTimeout(sendSize, RESIZE_DELAY);
}
addEventListener("resize", resize);
new ResizeObserver(resize).observe(get("panel"));
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
stage.addEventListener("pointerleave", () => { flush(); send("leave"); });
stage.addEventListener("contextmenu", (event) => event.preventDefault());
stage.addEventListener("wheel", (event) => {
  event.preventDefault();
  const lines = event.deltaMode === 0 ? event.deltaY / PIXELS_PER_NOTCH : event.deltaY / 3;
  send("wheel", Math.max(-50, Math.min(50, -lines)), event.timeStamp);
}, { passive: false });

// ---------------------------------------------------------------- keys

const LEFT_ALONE = ["F5", "F11", "Tab"];  // the browser's own

function key(event, down) {
  const writing = /^(SELECT|TEXTAREA)$/.test(event.target.tagName);
  const ctrl = event.ctrlKey || event.metaKey;
  const own = { F1: togglePanel, F2: openScenes }[event.code];
  if (own) {
    event.preventDefault();
    if (down && !event.repeat) own();
    return;
  }
  if (get("menu-of-scenes").open) return;
  if (event.key.toLowerCase() === "h" && !ctrl && !writing) {
    if (down && !event.repeat) showKeys();
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

const sections = new Map();  // title -> { element, summary, content, rows, shape }

function make(tag, properties = {}, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}

function button(name, act) {
  const made = make("button", { textContent: name, onclick: act });
  made.dataset.name = name;
  return made;
}

// For each kind of row: makes its element, and returns it with what shows a row's present content.
const ROWS = {
  ButtonGrid(row, act) {
    const buttons = row.buttons.map((one) => button(one.name, () => act(one.name, true)));
    const show = (now) => now.buttons.forEach((one, k) => {
      buttons[k].textContent = one.label;
      buttons[k].title = one.tip;
      buttons[k].classList.toggle("on", one.on);
    });
    return [make("div", { className: row.columns === 2 ? "grid two" : "grid three" }, ...buttons), show];
  },
  Choice(row, act) {
    if (row.listed) {
      const list = make("select", { className: "wide", title: row.tip });
      list.onchange = () => { act(row.name, list.value); stage.focus(); };
      const show = (now) => {
        const known = now.options.some(([name]) => name === now.current);
        const options = known ? now.options : [[now.current, ""], ...now.options];
        list.replaceChildren(...options.map(([name, text]) => new Option(text ? `${name}, ${text}` : name, name, false, name === now.current)));
      };
      list.dataset.name = row.name;
      return [list, show];
    }
    const buttons = row.options.map(([name, tip]) => Object.assign(button(name, () => act(row.name, name)), { title: tip }));
    const show = (now) => buttons.forEach((one) => one.classList.toggle("on", one.dataset.name === now.current));
    return [make("div", { className: "choice" }, ...buttons), show];
  },
  Slider(row, act) {
    const input = make("input", { type: "range", min: 0, max: SLIDER_STEPS, step: 1 });
    const name = make("span"), shown = make("output"), element = make("label", { className: "slider" }, name, shown, input);
    let slider = row, continued = false;
    input.onpointerdown = () => { continued = false; };
    input.oninput = () => {
      act(slider.name, valueOf(slider, Number(input.value)), continued);
      continued = input.matches(":active");
    };
    element.ondblclick = element.oncontextmenu = (event) => {  // a long press, too
      event.preventDefault();
      if (slider.usual !== null) act(slider.name, slider.usual);
    };
    return [element, (now) => {
      slider = now;
      element.title = now.tip;
      name.textContent = now.name;
      shown.textContent = now.shown;
      if (!input.matches(":active")) input.value = stepOf(now, now.value);
    }];
  },
  Toggle(row, act) {
    const input = make("input", { type: "checkbox" });
    input.onchange = () => act(row.name, input.checked);
    return [make("label", { className: "toggle" }, input, row.name), (now) => { input.checked = now.on; }];
  },
  Text() {
    const element = make("div", { className: "quiet" });
    return [element, (now) => { element.textContent = now.text; }];
  },
  Table(row) {
    const element = make("table", { className: row.head ? "numbers head" : "numbers" });
    return [element, (now) => fill(element, now.rows)];
  },
};

function sectionOf(title, about) {
  if (sections.has(title)) return sections.get(title);
  const summary = make("summary"), content = make("div");
  const element = about.plain ? make("section", {}, content) : make("details", { open: !about.folded }, summary, content);
  element.ontoggle = sendDetails;
  if (title === "Body") {
    element.onpointerenter = () => send("edits", true);
    element.onpointerleave = () => send("edits", false);
  }
  element.dataset.title = title;
  sections.set(title, { element, summary, content, rows: [], shape: "" });
  return sections.get(title);
}

function showSection(title, about) {
  const section = sectionOf(title, about);
  const shape = JSON.stringify(about.rows.map((row) => [row.kind, row.name, row.options, (row.buttons || []).map((one) => one.name)]));
  if (shape !== section.shape) {
    const act = (name, value, continued = false) => send("panel", title, name, value, continued);
    section.shape = shape;
    section.rows = about.rows.map((row) => ROWS[row.kind](row, act));
    section.content.replaceChildren(...section.rows.map(([element]) => element));
  }
  section.summary.textContent = about.label;
  about.rows.forEach((row, k) => section.rows[k][1](row));
}

function sendDetails() {
  const section = sections.get("Performance");
  send("details", Boolean(section && section.element.open) && !get("panel").hidden);
}

function fill(table, lines) {
  table.replaceChildren(...lines.map((line) => make("tr", {}, ...line.map((text) => make("td", { textContent: text })))));
}

let shownForKeys = false;
function showKeys() {  // the list of keys unfolds, in the panel, which goes away with it if it was hidden before
  const unfold = get("panel").hidden || !get("keys").open;
  get("keys").open = unfold;
  if (unfold) shownForKeys = get("panel").hidden;
  if (unfold ? get("panel").hidden : shownForKeys) togglePanel();
  if (unfold) get("keys").scrollIntoView();
}

function togglePanel() {
  get("panel").hidden = !get("panel").hidden;
  get("menu").classList.toggle("on", !get("panel").hidden);
  document.body.classList.toggle("open", !get("panel").hidden);
  sendDetails();
  if (get("panel").hidden) send("edits", false);
}

function buildScenes() {
  get("scenes").hidden = !hello.scenes.length;
  get("scene-list").replaceChildren(...hello.scenes.map((scene) => {
    const cell = make("div"), words = make("div"), options = {};
    cell.className = scene.name === hello.playing ? "scene now" : "scene";
    cell.tabIndex = 0;
    if (scene.picture) cell.append(Object.assign(new Image(), { src: scene.picture, alt: "" }));
    words.append(make("b", { textContent: scene.spoken }));
    for (const [name, [usual, ...choices]] of Object.entries(scene.options)) {
      const list = make("select");
      list.append(...choices.map((choice) => new Option(choice, choice, false, choice === usual)));
      list.onclick = (event) => event.stopPropagation();
      list.onchange = () => { options[name] = list.value; };
      words.append(list);
    }
    words.append(make("p", { textContent: scene.line }));
    cell.append(words);
    cell.onclick = () => { send("open", scene.name, options); get("menu-of-scenes").close(); };
    cell.onkeydown = (event) => { if (event.target === cell && event.code === "Enter") cell.click(); };
    return cell;
  }));
}

function openScenes() {
  const menu = get("menu-of-scenes");
  if (menu.open) menu.close();
  else if (hello && hello.scenes.length && state.role === "play") menu.showModal();
}

function build() {
  document.title = get("title").textContent = hello.title;
  buildScenes();
  get("cast").textContent = hello.cast.join("; ");
  const touch = matchMedia("(pointer: coarse)").matches;
  const gestures = touch ? [["One finger", "grab a body, release to throw; else turn around the scene"],
    ["Two fingers", "apart or together: nearer and farther; side by side: shift the view"],
    ["  while holding", "the body comes nearer or goes farther"]] : [];
  fill(get("key-list"), [...gestures, ...hello.keys]);
  const bold = (text) => make("b", { textContent: text });
  const hint = get("hint");
  hint.replaceChildren(bold("Drag"), " a body to grab it, let go to throw   ·   ", bold(touch ? "≡" : "F1"), " panel");
  if (!touch) hint.append("   ·   ", bold("P"), " demonstration");
}

// A slider has whole steps from 0; the program's values are between low and high, in equal ratios if it is logarithmic.
function valueOf(slider, step) {
  const part = step / SLIDER_STEPS;
  return slider.log ? slider.low * (slider.high / slider.low) ** part : slider.low + (slider.high - slider.low) * part;
}

function stepOf(slider, value) {
  const part = slider.log ? Math.log(Math.max(value, slider.low) / slider.low) / Math.log(slider.high / slider.low)
    : (value - slider.low) / (slider.high - slider.low);
  return Math.round(SLIDER_STEPS * part);
}

get("menu").onclick = togglePanel;
get("take").onclick = () => send("take");
get("scenes").onclick = openScenes;
get("close-scenes").onclick = () => get("menu-of-scenes").close();
get("menu-of-scenes").onclick = (event) => { if (event.target === get("menu-of-scenes")) event.target.close(); };
get("menu-of-scenes").onclose = () => stage.focus();
get("panel").addEventListener("click", (event) => {
  if (event.target.tagName === "BUTTON" && event.detail) stage.focus();  // a click, not a key: keys play on
});

// ---------------------------------------------------------------- what the program tells

function take(news) {
  if ("ping" in news) send("pong", news.ping);
  if ("title" in news) { hello = news; build(); }  // also when another scene is opened
  if ("overlay" in news) { marks = news.overlay; drawStrokes(); }
  Object.assign(state, news);
  if ("loading" in news) say(news.loading);
  if ("role" in news || "pages" in news) showRole();
  if ("message" in news || "score" in news || "notice" in news || "opening" in news) {
    get("score").textContent = state.score;
    get("message").textContent = state.message;
    get("notice").textContent = state.opening || state.notice;
    get("line").hidden = !(state.score || state.message || state.notice || state.opening);
  }
  if ("editable" in news) {
    get("controls").hidden = false;
    get("hint").hidden = !state.editable || state.role !== "play" || get("hint").classList.contains("gone");
    setTimeout(() => get("hint").classList.add("gone"), HINT_SECONDS * 1000);
  }
  if ("sections" in news) {
    const listed = news.sections.map((title) => sectionOf(title, state[`section ${title}`]).element);
    get("sections").replaceChildren(...listed);
  }
  for (const title of state.sections || []) if (`section ${title}` in news) showSection(title, state[`section ${title}`]);
  if ("fps" in news) get("fps").textContent = state.fps === null ? "at rest" : `${state.fps} fps`;
  if ("film" in news) {
    const seconds = String((state.film || 0) % 60).padStart(2, "0");
    get("film").textContent = `${Math.floor((state.film || 0) / 60)}:${seconds}`;
    get("film").hidden = state.film === null;
  }
  if ("grabbing" in news) {
    stage.classList.toggle("grabbing", state.grabbing);
    if (state.grabbing) get("hint").classList.add("gone");
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
if (innerWidth >= 900) togglePanel();
