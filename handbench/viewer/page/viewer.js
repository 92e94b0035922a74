"use strict";
const $ = (id) => document.getElementById(id);
const START = { pose: 0, yaw: 0, pitch: 0, zoom: 0, light: 0, turn: 0, exposure: 0 };
const RANGES = { turn: "°", yaw: "°", pitch: "°", zoom: "×", exposure: " EV" };
const REST = 300; // ms without a change until what stands still is drawn whole
const SLOW = 125; // ms: pictures that take longer are drafts while something moves
const view = { ...START };
let changed = -REST;
let avatars = [];
let playing = false;
let last = 0;

const wrapped = (degrees) => ((((degrees + 180) % 360) + 360) % 360) - 180;
const clamped = (value, low, high) => Math.min(high, Math.max(low, value));

function set(changes) {
  Object.assign(view, changes);
  changed = performance.now();
  view.yaw = wrapped(view.yaw);
  view.turn = wrapped(view.turn);
  view.pitch = clamped(view.pitch, -85, 85);
  view.zoom = clamped(view.zoom, -2, 2);
  view.exposure = clamped(view.exposure, -5, 5);
  for (const [name, unit] of Object.entries(RANGES)) {
    $(name).value = view[name];
    const shown = name === "zoom" ? 2 ** view.zoom : view[name];
    $(`${name}-out`).textContent = (unit === "°" ? Math.round(shown) : shown.toFixed(2)) + unit;
  }
  $("light").value = view.light;
  $("pose").value = view.pose;
  for (const each of avatars) ask(each);
  askMap();
}

const number = (value) => String(Number(value.toFixed(4)));

// What a picture costs depends on what is another than in the one before: pose, camera or size, or the light alone.
function kindOf(query, before) {
  const other = (...names) => !before || names.some((name) => query[name] !== before[name]);
  if (other("pose")) return "pose";
  return other("yaw", "pitch", "zoom", "draft") ? "camera" : "light";
}

// Whether the next picture is to be a draft: something moves, and whole pictures of its kind are slow.
function drafted(avatar, query) {
  if (performance.now() - changed > REST) return false;
  const kind = kindOf({ ...query, draft: avatar.shown ? avatar.shown.draft : 0 }, avatar.shown);
  if (!(avatar.whole[kind] > SLOW)) return false;
  avatar.whole[kind] *= 0.97; // so that a whole one is tried again some time
  return true;
}

// One request at a time for each avatar: what is asked meanwhile is asked once more at the end, as it then is.
async function ask(avatar) {
  avatar.wanted = true;
  if (avatar.busy) return;
  avatar.busy = true;
  clearTimeout(avatar.rest);
  while (avatar.wanted) {
    avatar.wanted = false;
    const query = {
      avatar: avatar.number, pose: Math.min(view.pose, avatar.poses.length - 1), yaw: number(view.yaw), pitch: number(view.pitch),
      zoom: number(2 ** view.zoom), light: view.light, turn: number(view.turn), exposure: number(view.exposure),
    };
    query.draft = drafted(avatar, query) ? 1 : 0;
    try {
      const answer = await fetch(`picture?${new URLSearchParams(query)}`);
      if (!answer.ok) throw new Error((await answer.json()).error);
      show(avatar, query, await createImageBitmap(await answer.blob()), Number(answer.headers.get("X-Milliseconds")));
      avatar.error = "";
    } catch (error) {
      avatar.error = error.message || "the viewer's server does not answer; start it again";
    }
    fail(avatars.map((each) => each.error).find(Boolean) || "");
  }
  avatar.busy = false;
  if (avatar.shown && avatar.shown.draft && !avatar.error) avatar.rest = setTimeout(() => ask(avatar), REST);
}

function show(avatar, query, picture, ms) {
  avatar.canvas.width = picture.width;
  avatar.canvas.height = picture.height;
  avatar.canvas.getContext("2d").drawImage(picture, 0, 0);
  if (!query.draft && avatar.shown) avatar.whole[kindOf(query, avatar.shown)] = ms; // the first compiles what it needs
  avatar.shown = query;
  const now = performance.now();
  const rate = avatar.drawn ? 1000 / (now - avatar.drawn) : 0;
  avatar.drawn = now;
  avatar.rate = rate > 1 ? 0.8 * (avatar.rate || rate) + 0.2 * rate : 0;
  avatar.count += 1;
  Object.assign(avatar.canvas.dataset, { count: avatar.count, draft: query.draft });
  avatar.time.textContent =
    (query.draft ? "draft · " : "") + `${ms.toFixed(0)} ms` + (avatar.rate ? ` · ${avatar.rate.toFixed(1)} / s` : "");
}

let mapBusy = false;
let mapWanted = "";
let mapShown = "";
async function askMap() {
  mapWanted = `light?light=${view.light}&turn=${Math.round(view.turn)}`;
  if (mapBusy) return;
  mapBusy = true;
  while (mapWanted !== mapShown) {
    mapShown = mapWanted;
    try {
      const answer = await fetch(mapShown);
      if (answer.ok) {
        const old = $("map").src;
        $("map").src = URL.createObjectURL(await answer.blob());
        if (old) URL.revokeObjectURL(old);
      }
    } catch { /* the pictures tell that the server is gone */ }
  }
  mapBusy = false;
}

function fail(text) {
  $("error").hidden = !text;
  $("error").textContent = text;
}

function play(now) {
  if (!playing) return;
  const step = last ? Math.min(now - last, 200) : 0;
  last = now;
  if (avatars.every((each) => !each.busy)) set({ turn: view.turn + 0.045 * Math.max(step, 16) * 2 });
  requestAnimationFrame(play);
}

function setPlaying(on) {
  playing = on;
  last = 0;
  $("play").setAttribute("aria-pressed", String(on));
  if (on) requestAnimationFrame(play);
}

function step(name, by) {
  const count = name === "light" ? $("light").options.length : $("pose").options.length;
  set({ [name]: (view[name] + by + count) % count });
}

const KEYS = {
  ArrowLeft: (shift) => set(shift ? { turn: view.turn - 5 } : { yaw: view.yaw - 5 }),
  ArrowRight: (shift) => set(shift ? { turn: view.turn + 5 } : { yaw: view.yaw + 5 }),
  ArrowUp: () => set({ pitch: view.pitch + 5 }),
  ArrowDown: () => set({ pitch: view.pitch - 5 }),
  "+": () => set({ zoom: view.zoom + 0.1 }),
  "=": () => set({ zoom: view.zoom + 0.1 }),
  "-": () => set({ zoom: view.zoom - 0.1 }),
  "[": () => step("pose", -1),
  "]": () => step("pose", 1),
  l: (shift) => step("light", shift ? -1 : 1),
  e: () => set({ exposure: view.exposure + 0.25 }),
  d: () => set({ exposure: view.exposure - 0.25 }),
  " ": () => setPlaying(!playing),
  0: () => { setPlaying(false); set(START); },
};

function listen() {
  const stage = $("stage");
  stage.addEventListener("keydown", (event) => {
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    const action = event.ctrlKey || event.metaKey || event.altKey ? undefined : KEYS[key];
    if (!action) return;
    event.preventDefault();
    action(event.shiftKey);
  });
  stage.addEventListener("pointerdown", (event) => {
    stage.setPointerCapture(event.pointerId);
    stage.classList.add("held");
    stage.focus({ preventScroll: true });
  });
  stage.addEventListener("pointermove", (event) => {
    if (!stage.classList.contains("held") || !event.buttons) return;
    if (event.shiftKey || event.buttons === 2) set({ turn: view.turn + 0.5 * event.movementX });
    else set({ yaw: view.yaw - 0.5 * event.movementX, pitch: view.pitch + 0.5 * event.movementY });
  });
  for (const end of ["pointerup", "pointercancel"]) stage.addEventListener(end, () => stage.classList.remove("held"));
  stage.addEventListener("contextmenu", (event) => event.preventDefault());
  stage.addEventListener("wheel", (event) => {
    event.preventDefault();
    set({ zoom: view.zoom - Math.sign(event.deltaY) * 0.1 });
  }, { passive: false });
  for (const name of Object.keys(RANGES)) $(name).addEventListener("input", () => set({ [name]: Number($(name).value) }));
  for (const name of ["light", "pose"]) $(name).addEventListener("change", () => set({ [name]: Number($(name).value) }));
  $("play").addEventListener("click", () => setPlaying(!playing));
  $("reset").addEventListener("click", () => { setPlaying(false); set(START); });
}

async function open() {
  const state = await (await fetch("state")).json();
  avatars = state.avatars.map((told, index) => {
    const figure = document.createElement("figure");
    const canvas = document.createElement("canvas");
    const caption = document.createElement("figcaption");
    const [name, time] = [document.createElement("span"), document.createElement("span")];
    [canvas.width, canvas.height] = told.size;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `${told.name}, ${told.subject}`);
    name.textContent = told.name === told.title ? `${told.title} · ${told.subject}` : `${told.name} · ${told.title}`;
    time.className = "time";
    caption.append(name, time);
    figure.append(canvas, caption);
    $("stage").append(figure);
    return { ...told, number: index, canvas, time, count: 0, busy: false, wanted: false, drawn: 0, error: "", whole: {}, shown: null, rest: 0 };
  });
  const longest = state.avatars.reduce((one, other) => (other.poses.length > one.poses.length ? other : one));
  longest.poses.forEach((name, index) => $("pose").add(new Option(name, index)));
  state.lights.forEach((name, index) => $("light").add(new Option(name, index)));
  listen();
  set(START);
}

open().catch((error) => fail(error.message));
