// The state of the page that a link can hold: "#metric=ssim&left=urhand", kept while the page is used.
const state = {
  get: (name) => new URLSearchParams(location.hash.includes("=") ? location.hash.slice(1) : "").get(name),
  set(changes) {
    const kept = new URLSearchParams(location.hash.includes("=") ? location.hash.slice(1) : "");
    for (const [name, value] of Object.entries(changes)) {
      if (value === "" || value === null) kept.delete(name);
      else kept.set(name, value);
    }
    history.replaceState(null, "", `#${kept.toString().replaceAll("%2F", "/")}`);
  },
};
// The overview shows one metric at a time; small screens begin without intervals.
const picker = document.querySelector(".picker");
const buttons = [...picker.querySelectorAll("button")];
function pick(metric) {
  const button = buttons.find((each) => each.dataset.metric === metric);
  if (!button) return;
  for (const each of buttons) each.setAttribute("aria-pressed", String(each === button));
  for (const cell of document.querySelectorAll(".overview [data-metric]")) cell.hidden = cell.dataset.metric !== metric;
  for (const line of document.querySelectorAll(".overview .published")) line.hidden = !line.querySelector("td:not([hidden], [data-value=''])");
  document.querySelector(".overview .metric").textContent = button.textContent;
}
for (const button of buttons) {
  button.addEventListener("click", () => {
    pick(button.dataset.metric);
    state.set({ metric: button === buttons[0] ? "" : button.dataset.metric });
    cues();
  });
}
const intervals = picker.querySelector(".intervals");
function showIntervals() {
  document.getElementById("results").classList.toggle("plain", !intervals.checked);
  cues();
}
intervals.addEventListener("change", showIntervals);
picker.hidden = false;
pick(state.get("metric"));
if (matchMedia("(max-width: 40rem)").matches) intervals.checked = false;
showIntervals();
// Of the figures that a group of choices is for, show those that agree with every pressed button.
for (const choices of document.querySelectorAll(".choices")) {
  const figures = [...document.getElementById(choices.dataset.for).children];
  function apply() {
    const pressed = [...choices.querySelectorAll('[aria-pressed="true"]')].flatMap((button) => Object.entries(button.dataset));
    for (const figure of figures) figure.hidden = !pressed.every(([name, value]) => figure.dataset[name] === value);
  }
  for (const group of choices.querySelectorAll('[role="group"]')) {
    group.addEventListener("click", ({ target }) => {
      if (target.tagName !== "BUTTON") return;
      for (const button of group.children) button.setAttribute("aria-pressed", String(button === target));
      apply();
    });
  }
  choices.hidden = false;
  apply();
}
// (query, title, title beside it or null for the truth) shows a frame in the viewer; null on a page without one.
let viewerShow = null;
