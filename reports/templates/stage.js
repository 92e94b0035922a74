// Two pictures on top of each other with a divider between them. Both share zoom and pan; positions are shares of the stage.
function makeStage(stage, slider, changed) {
  const MOST = 16;
  const view = { split: 50, zoom: 1, x: 0, y: 0 };
  const down = new Map(); // pointers that touch the stage: id to place
  let moving = "";

  function show() {
    stage.style.setProperty("--split", view.split);
    for (const canvas of stage.querySelectorAll("canvas")) {
      canvas.style.transform = `translate(${100 * view.x}%, ${100 * view.y}%) scale(${view.zoom})`;
    }
    stage.classList.toggle("zoomed", view.zoom > 1);
    stage.classList.toggle("pixels", view.zoom >= 3);
    slider.value = view.split;
    changed(view);
  }
  function split(percent) {
    view.split = Math.min(100, Math.max(0, percent));
    show();
  }
  function pan(dx, dy) {
    view.x = Math.min(0, Math.max(1 - view.zoom, view.x + dx));
    view.y = Math.min(0, Math.max(1 - view.zoom, view.y + dy));
    show();
  }
  // Zoom by a factor so that the place [x, y] stays where it is.
  function zoom(factor, [x, y] = [0.5, 0.5]) {
    const before = view.zoom;
    view.zoom = Math.min(MOST, Math.max(1, before * factor));
    if (Math.abs(view.zoom - 1) < 0.01) view.zoom = 1;
    const grown = view.zoom / before;
    pan(x - (x - view.x) * grown - view.x, y - (y - view.y) * grown - view.y);
  }
  function place(event) {
    const box = stage.getBoundingClientRect();
    return [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
  }

  slider.addEventListener("input", () => split(Number(slider.value)));
  stage.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    stage.setPointerCapture(event.pointerId);
    down.set(event.pointerId, place(event));
    const grasped = event.target.classList.contains("divider");
    moving = down.size > 1 ? "pinch" : view.zoom > 1 && !grasped ? "pan" : "split";
    stage.classList.toggle("panning", moving === "pan");
    if (moving === "split" && event.pointerType === "mouse") split(100 * place(event)[0]);
  });
  stage.addEventListener("pointermove", (event) => {
    if (!down.has(event.pointerId)) return;
    const [from, to] = [down.get(event.pointerId), place(event)];
    down.set(event.pointerId, to);
    if (moving === "split") split(100 * to[0]);
    else pan((to[0] - from[0]) / (moving === "pinch" ? 2 : 1), (to[1] - from[1]) / (moving === "pinch" ? 2 : 1));
    if (moving !== "pinch" || down.size !== 2) return;
    const [other] = [...down.entries()].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
    const apart = (at) => Math.hypot(at[0] - other[0], at[1] - other[1]);
    if (apart(from) > 0.01) zoom(apart(to) / apart(from), [(to[0] + other[0]) / 2, (to[1] + other[1]) / 2]);
  });
  for (const end of ["pointerup", "pointercancel"]) {
    stage.addEventListener(end, (event) => {
      down.delete(event.pointerId);
      moving = down.size ? "pan" : "";
      stage.classList.toggle("panning", moving === "pan");
    });
  }
  // The wheel scrolls the page until the stage is chosen; zoomed out fully, it scrolls on.
  stage.addEventListener("wheel", (event) => {
    const wanted = event.ctrlKey || event.metaKey || document.activeElement === stage;
    if (!wanted || (event.deltaY > 0 && view.zoom === 1)) return;
    event.preventDefault();
    zoom(Math.exp(-event.deltaY / (event.deltaMode ? 10 : 300)), place(event));
  }, { passive: false });
  stage.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const [across, along] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key] ?? [0, 0];
    if (event.key === "+" || event.key === "=") zoom(1.5);
    else if (event.key === "-") zoom(1 / 1.5);
    else if (event.key === "0") zoom(0);
    else if (view.zoom > 1 && (across || along)) pan(-0.1 * across, -0.1 * along);
    else if (across) split(view.split + 2 * across);
    else return;
    event.preventDefault();
  });
  return { show, zoom };
}
