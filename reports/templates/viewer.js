// Choose a frame and two methods; draw both, their scores and, if wanted, where they are wrong.
const root = document.querySelector(".viewer");
if (root) {
  const data = JSON.parse(document.getElementById("viewer-data").textContent);
  const get = (selector) => root.querySelector(selector);
  const form = get("form").elements;
  const KEYS = ["subject", "pose", "camera", "light"];
  const colours = new Uint8Array(data.colours.match(/../g).map((byte) => parseInt(byte, 16)));
  const stage = makeStage(get(".stage"), get(".split"), ({ split, zoom }) => {
    const share = Math.round(split);
    get(".split").setAttribute("aria-valuetext", `${share} % ${title("left")}, ${100 - share} % ${title("right")}`);
    get(".zoom").value = `${Number(zoom.toFixed(1))}×`;
  });
  const query = (each) => KEYS.map((key) => each[key]).join("/");
  let frame = data.frames.find((each) => query(each) === state.get("frame")) ?? data.frames[0];
  let latest = 0;
  let decoded = new Map(); // of the frame that is shown: index to pixels

  function title(side) {
    return data.titles[form[side].value];
  }
  function option(value, text) {
    return new Option(text, value);
  }
  // The options of the four choices: each leaves those that go with the choices before it.
  function fill() {
    let left = pool();
    for (const key of KEYS) {
      const values = new Map(left.map((each) => [each[key], each.kind]));
      const sorted = [...values.keys()].sort((a, b) => a.localeCompare(b, "en", { numeric: true }));
      if (key !== "light") form[key].replaceChildren(...sorted.map((value) => option(value, value)));
      else form[key].replaceChildren(...Object.entries(data.kinds).flatMap(([kind, title]) => {
        const group = document.createElement("optgroup");
        group.label = title;
        group.append(...sorted.filter((value) => values.get(value) === kind).map((value) => option(value, value)));
        return group.childElementCount ? [group] : [];
      }));
      form[key].value = frame[key];
      left = left.filter((each) => each[key] === frame[key]);
    }
    const lamp = get(".lamp");
    lamp.hidden = frame.lamp === null;
    lamp.querySelector("img")?.remove();
    if (!lamp.hidden) {
      const picture = new Image(128, 64);
      picture.src = `data:image/png;base64,${data.lamps[frame.lamp]}`;
      picture.alt = `Light ${frame.light}, as seen from the hand`;
      lamp.prepend(picture);
    }
    get(".place").value = `${pool().indexOf(frame) + 1} of ${pool().length}`;
  }
  function pool() {
    return data.frames.filter((each) => !form.column.value || each.columns.includes(form.column.value));
  }
  // The frame that agrees with a choice and the ones before it, and in as many of the others as can be.
  function choose(key, value) {
    const wanted = { ...frame, [key]: value };
    const before = KEYS.slice(0, KEYS.indexOf(key) + 1);
    const agreeing = pool().filter((each) => before.every((name) => each[name] === wanted[name]));
    const agreement = (each) => KEYS.filter((name) => each[name] === wanted[name]).length;
    go(agreeing.reduce((best, each) => (agreement(each) > agreement(best) ? each : best)));
  }
  function go(to) {
    if (to !== frame) decoded = new Map();
    frame = to;
    fill();
    draw();
  }
  // What a byte of a picture shows at the chosen exposure: the sRGB curve up to the knee, then stops above white.
  function tones() {
    const gain = 2 ** Number(get(".exposing").value);
    return Uint8ClampedArray.from({ length: 256 }, (_, byte) => {
      const v = byte / 255;
      const s = v / data.knee;
      const linear = v > data.knee ? 2 ** (((v - data.knee) / (1 - data.knee)) * data.stops) : s <= 0.04045 ? s / 12.92 : ((s + 0.055) / 1.055) ** 2.4;
      const shown = Math.min(1, gain * linear);
      return 255 * (shown <= 0.0031308 ? 12.92 * shown : 1.055 * shown ** (1 / 2.4) - 0.055);
    });
  }
  function step(by) {
    const frames = pool();
    go(frames[(frames.indexOf(frame) + by + frames.length) % frames.length]);
  }

  async function decode(picture) {
    const image = new Image();
    image.src = `data:image/webp;base64,${picture}`;
    await image.decode();
    const canvas = Object.assign(document.createElement("canvas"), { width: image.naturalWidth, height: image.naturalHeight });
    const context = canvas.getContext("2d", { willReadFrequently: true });
    context.drawImage(image, 0, 0);
    return context.getImageData(0, 0, canvas.width, canvas.height);
  }
  async function pixels(index) {
    if (!frame.pictures[index]) return null;
    if (!decoded.has(index)) decoded.set(index, decode(frame.pictures[index]));
    const stored = await decoded.get(index);
    const [shown, tone] = [new ImageData(stored.width, stored.height), tones()];
    for (let i = 0; i < stored.data.length; i++) shown.data[i] = i % 4 === 3 ? 255 : tone[stored.data[i]];
    return shown;
  }
  function error(picture, truth) {
    const found = new ImageData(picture.width, picture.height);
    for (let i = 0; i < found.data.length; i += 4) {
      let sum = 0;
      for (let c = 0; c < 3; c++) sum += Math.abs(picture.data[i + c] - truth.data[i + c]);
      const level = Math.min(255, Math.round(sum / 3 / data.scale));
      found.data.set([colours[3 * level], colours[3 * level + 1], colours[3 * level + 2], 255], i);
    }
    return found;
  }
  function words(index) {
    const scores = frame.scores[index];
    const first = scores ? `, ${data.metrics[0].title} ${scores[0]} ${data.metrics[0].unit}`.trimEnd() : "";
    const map = get(".error").checked && index ? ", error map" : "";
    return `${data.titles[index]}${map}${first}`;
  }
  async function draw() {
    const turn = ++latest;
    get(".stage").setAttribute("aria-busy", "true");
    const chosen = { left: Number(form.left.value), right: Number(form.right.value) };
    const [truth, left, right] = await Promise.all([pixels(0), pixels(chosen.left), pixels(chosen.right)]);
    if (turn !== latest) return;
    const sized = truth || left || right || { width: 3, height: 4 };
    root.style.setProperty("--ratio", sized.width / sized.height);
    for (const [side, picture] of Object.entries({ left, right })) {
      const index = chosen[side];
      const wrong = get(".error").checked && index > 0 && truth;
      const canvas = get(`.side.${side} canvas`);
      canvas.width = sized.width;
      canvas.height = sized.height;
      if (picture) canvas.getContext("2d").putImageData(wrong ? error(picture, truth) : picture, 0, 0);
      canvas.setAttribute("aria-label", words(index));
      get(`.side.${side} .missing`).textContent = picture ? "" : `No picture: ${frame.reasons[index]}`;
      get(`.tag.${side}`).textContent = data.titles[index] + (wrong ? ", error" : "");
      get(`.scores th.${side}`).textContent = data.titles[index];
      root.querySelectorAll(`.scores td.${side}`).forEach((cell, i) => {
        cell.textContent = frame.scores[index] ? `${frame.scores[index][i]} ${data.metrics[i].unit}`.trimEnd() : "–";
      });
    }
    stage.show();
    const stops = Number(get(".exposing").value);
    get(".ev").value = (stops > 0 ? "+" : "") + String(stops).replace("-", "−");
    const files = [chosen.left, chosen.right].map((index) => frame.files[index]).filter(Boolean);
    get(".exposure").textContent = `${frame.columns.map((name) => data.columns[name]).join(", ")}. Exposure ×${frame.exposure}.`;
    get(".halves").hidden = !files.length;
    get(".halves ul").replaceChildren(...[...new Set(files)].map((file) => Object.assign(document.createElement("li"), { textContent: file })));
    if (get(".all").open) await drawAll(turn);
    state.set({
      frame: frame === data.frames[0] ? "" : query(frame),
      left: form.left.value === "0" ? "" : data.names[form.left.value],
      right: Number(form.right.value) === data.best ? "" : data.names[form.right.value],
      error: get(".error").checked ? "1" : "",
      stops: stops ? String(stops) : "",
    });
    get(".legend").hidden = !get(".error").checked;
    get(".said").textContent = `Left: ${words(chosen.left)}; right: ${words(chosen.right)}.`;
    get(".stage").setAttribute("aria-busy", "false");
  }

  // Every method of the frame side by side, as large as there is room; a picture that is chosen goes to the right side.
  async function drawAll(turn) {
    const pictures = await Promise.all(data.titles.map((_, index) => pixels(index)));
    if (turn !== latest) return;
    get(".tiles").replaceChildren(...data.titles.map((name, index) => {
      const tile = document.createElement("button");
      tile.type = "button";
      const picture = pictures[index];
      if (picture) {
        const canvas = Object.assign(document.createElement("canvas"), { width: picture.width, height: picture.height });
        const wrong = get(".error").checked && index > 0 && pictures[0];
        canvas.getContext("2d").putImageData(wrong ? error(picture, pictures[0]) : picture, 0, 0);
        tile.append(canvas);
      }
      const score = frame.scores[index] ? `${frame.scores[index][0]} ${data.metrics[0].unit}` : "";
      const told = document.createElement("span");
      told.textContent = picture ? `${name} ${score}`.trimEnd() : `${name}: no picture, ${frame.reasons[index]}`;
      tile.append(told);
      tile.addEventListener("click", () => { form.right.value = index; draw(); });
      return tile;
    }));
  }

  form.column.append(option("", "All"), ...Object.entries(data.columns).map(([name, title]) => option(name, title)));
  for (const side of ["left", "right"]) form[side].append(...data.titles.map((title, index) => option(index, title)));
  const named = (side, otherwise) => (data.names.includes(state.get(side)) ? data.names.indexOf(state.get(side)) : otherwise);
  form.left.value = named("left", 0);
  form.right.value = named("right", data.best);
  get(".error").checked = state.get("error") === "1";
  get(".exposing").value = state.get("stops") ?? 0;
  viewerShow = (wanted, mine, beside) => {
    const found = data.frames.find((each) => query(each) === wanted);
    if (!found) { said.textContent = `${wanted} is not among the frames of the viewer.`; return; }
    form.column.value = "";
    const index = (name) => Math.max(0, data.titles.indexOf(name));
    [form.left.value, form.right.value] = [beside === null ? 0 : index(beside), index(mine)];
    go(found);
    document.getElementById("viewer").scrollIntoView({ block: "start" });
    get(".stage").focus({ preventScroll: true });
  };
  for (const side of ["left", "right"]) {
    const link = get(`.save.${side}`);
    link.addEventListener("click", () => {
      const index = Number(form[side].value);
      link.href = get(`.side.${side} canvas`).toDataURL("image/png");
      link.download = `${query(frame).replaceAll("/", "__")}--${data.names[index]}${get(".error").checked && index ? "-error" : ""}.png`;
    });
  }
  get(".exposing").addEventListener("input", draw);
  get(".all").addEventListener("toggle", draw);
  for (const key of KEYS) form[key].addEventListener("change", () => choose(key, form[key].value));
  form.column.addEventListener("change", () => go(pool().includes(frame) ? frame : pool()[0]));
  for (const choice of [form.left, form.right, get(".error")]) choice.addEventListener("change", draw);
  get(".before").addEventListener("click", () => step(-1));
  get(".after").addEventListener("click", () => step(1));
  get(".in").addEventListener("click", () => stage.zoom(1.5));
  get(".out").addEventListener("click", () => stage.zoom(1 / 1.5));
  get(".fit").addEventListener("click", () => stage.zoom(0));
  get(".swap").addEventListener("click", () => {
    [form.left.value, form.right.value] = [form.right.value, form.left.value];
    draw();
  });
  get(".stage").addEventListener("keydown", (event) => {
    if (event.key === "e" && !event.ctrlKey && !event.metaKey && !event.altKey) get(".error").click();
  });
  root.hidden = false;
  fill();
  draw();
}
