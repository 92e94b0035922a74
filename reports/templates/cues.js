// What is wider than its place says so, and fades where it goes on.
const wide = [...document.querySelectorAll(".scroll")].map((place) => {
  const cue = document.createElement("p");
  cue.className = "cue";
  cue.hidden = true;
  cue.textContent = "more to the right →";
  cue.setAttribute("aria-hidden", "true");
  place.before(cue);
  place.addEventListener("scroll", () => fade(place), { passive: true });
  return [place, cue];
});
function fade(place) {
  const more = place.scrollWidth - place.clientWidth - place.scrollLeft > 2;
  if (more) place.dataset.more = "right";
  else delete place.dataset.more;
}
function cues() {
  for (const [place, cue] of wide) {
    cue.hidden = place.scrollWidth - place.clientWidth <= 2;
    fade(place);
  }
}
addEventListener("resize", cues);
