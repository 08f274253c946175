// The controls around the picture: how it is compared, coloured and turned. Keyboard and pointer end in the same calls.

import { coloured } from "./colouring.js";
import { showScale } from "./scale.js";

const $ = (id) => document.getElementById(id);
const radios = (name) => [...document.querySelectorAll(`input[name=${name}]`)];
const STEP = 0.14; // radians a key turns
const PUSH = 0.06; // share of the distance a key moves

export class Controls {
  constructor(stage, { announce, save }) {
    this.stage = stage;
    this.announce = announce; // for those who do not see it
    this.save = save;
    this.display = null;
    this.colouring = "shaded";
    this.panel = $("stage");
    for (const radio of radios("view")) radio.addEventListener("change", () => this.view(radio.value));
    for (const radio of radios("colour")) radio.addEventListener("change", () => this.colour(radio.value));
    $("size").addEventListener("input", () => this.size(Number($("size").value)));
    $("flip").addEventListener("click", () => this.flip());
    $("reset").addEventListener("click", () => stage.reset());
    $("zoom-in").addEventListener("click", () => stage.zoom(1.25));
    $("zoom-out").addEventListener("click", () => stage.zoom(0.8));
    $("up").addEventListener("click", () => this.up(stage.up === "z" ? "y" : "z"));
    $("picture").addEventListener("click", () => this.save());
    this.divide(0.5);
    this.drag($("divider"));
  }

  /** Show another display file, coloured by the file where it has colours. */
  load(display) {
    this.display = display;
    this.stage.load(display);
    const file = $("colour-file").querySelector("input");
    file.disabled = !display.before.COLOR_0;
    $("colour-file").title = file.disabled ? "The file carries no colours" : "";
    this.colour("shaded");
    this.view("split");
    this.divide(0.5);
    this.size(0);
  }

  view(view) {
    for (const radio of radios("view")) radio.checked = radio.value === view;
    this.stage.set({ view });
    this.panel.dataset.view = view;
    if (view === "flip") this.flip(this.stage.shown);
  }

  /** Show one cloud, the other one without an argument. */
  flip(shown = this.stage.shown === "after" ? "before" : "after") {
    this.stage.set({ shown });
    this.panel.dataset.shown = shown;
    $("flip").setAttribute("aria-label", `Showing ${shown}; press for the other`);
  }

  colour(colouring) {
    const radio = radios("colour").find(({ value }) => value === colouring);
    if (!this.display || radio.disabled) return;
    radio.checked = true;
    this.colouring = colouring;
    this.stage.colour(coloured(this.display, colouring, this.stage.up));
    showScale($("scale"), this.display, colouring, this.stage.up);
  }

  /** Set the size of points: ten steps are a factor of two. */
  size(steps) {
    const slider = $("size");
    slider.value = steps;
    const factor = 2 ** (Number(slider.value) / 10);
    $("size-value").textContent = `${factor.toFixed(1)} ×`;
    this.stage.set({ factor });
  }

  up(up) {
    this.stage.turnUp(up);
    $("up").firstElementChild.textContent = up.toUpperCase();
    if (this.colouring === "height") this.colour("height");
    this.announce(`${up.toUpperCase()} is up`);
  }

  /** Put the divider at a share of the width. */
  divide(split) {
    const at = Math.min(1, Math.max(0, split));
    this.panel.style.setProperty("--split", `${at * 100}%`);
    $("divider").setAttribute("aria-valuenow", Math.round(at * 100));
    $("divider").setAttribute("aria-valuetext", `${Math.round(at * 100)} % before`);
    this.panel.dataset.hidden = at < 0.12 ? "before" : at > 0.88 ? "after" : "";
    this.stage.set({ split: at });
  }

  drag(divider) {
    const follow = (event) => {
      const box = this.panel.getBoundingClientRect();
      this.divide((event.clientX - box.left) / box.width);
    };
    divider.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      divider.setPointerCapture(event.pointerId);
      divider.addEventListener("pointermove", follow);
    });
    for (const end of ["pointerup", "pointercancel"]) {
      divider.addEventListener(end, () => divider.removeEventListener("pointermove", follow));
    }
    divider.addEventListener("dblclick", () => this.divide(0.5));
    divider.addEventListener("keydown", (event) => {
      const step = event.shiftKey ? 0.1 : 0.02;
      const to = { ArrowLeft: this.stage.split - step, ArrowRight: this.stage.split + step, Home: 0, End: 1 }[event.key];
      if (to === undefined) return;
      event.preventDefault();
      event.stopPropagation();
      this.divide(to);
    });
  }

  /** What each key does while a result is shown: [keys, label, what]. */
  keys() {
    const { stage } = this;
    const colour = (name) => () => this.colour(name);
    const one = (shown) => () => {
      this.view("flip");
      this.flip(shown);
    };
    return [
      [["a"], "Before", one("before")],
      [["b"], "After", one("after")],
      [[" "], "The other one", () => (stage.view === "flip" ? this.flip() : this.view("flip"))],
      [["s"], "Split", () => this.view("split")],
      [["d"], "Side by side", () => this.view("side")],
      [["o"], "Overlay", () => this.view("overlay")],
      [[",", "."], "Move the split", (key) => this.divide(stage.split + (key === "," ? -0.05 : 0.05))],
      [["1"], "Colour: shaded", colour("shaded")],
      [["2"], "Colour: the file's", colour("file")],
      [["3"], "Colour: height", colour("height")],
      [["4"], "Colour: displacement", colour("displacement")],
      [["5"], "Colour: normal", colour("normal")],
      [["[", "]"], "Smaller, larger points", (key) => this.size(Number($("size").value) + (key === "[" ? -2 : 2))],
      [["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown"], "Turn, with Shift move", (key, shift) => this.arrow(key, shift)],
      [["+", "=", "-"], "Closer, farther", (key) => stage.zoom(key === "-" ? 0.8 : 1.25)],
      [["r"], "Fit the cloud", () => stage.reset()],
      [["z", "y"], "Which axis is up", (key) => this.up(key)],
      [["p"], "Save a picture", () => this.save()],
    ];
  }

  arrow(key, shift) {
    const [right, up] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[key];
    if (shift) this.stage.move(right * PUSH, up * PUSH);
    else this.stage.turn(right * STEP, -up * STEP);
  }
}
