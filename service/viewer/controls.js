// The controls around the picture: how it is compared, coloured and turned. Keyboard and pointer end in the same calls.

import { coloured } from "./colouring.js";
import { showScale } from "./scale.js";

const $ = (id) => document.getElementById(id);
const radios = (name) => [...document.querySelectorAll(`input[name=${name}]`)];
const STEP = 0.14; // radians a key turns
const PUSH = 0.06; // share of the distance a key moves
const UPS = ["z", "y", "x", "-z", "-y", "-x"]; // in the order in which the button tries them
const VIEWS = ["split", "flip", "side", "overlay"];

export class Controls {
  /** `changed` is called when what an address says of the look has changed. */
  constructor(stage, { announce, save, changed }) {
    this.stage = stage;
    this.announce = announce; // for those who do not see it
    this.save = save;
    this.changed = changed;
    stage.rested = changed;
    this.display = null;
    this.colouring = "shaded";
    this.panel = $("stage");
    for (const radio of radios("view")) radio.addEventListener("change", () => this.view(radio.value));
    for (const radio of radios("colour")) radio.addEventListener("change", () => this.colour(radio.value));
    $("size").addEventListener("input", () => this.size(Number($("size").value)));
    $("flip").addEventListener("click", () => this.flip());
    $("reset").addEventListener("click", () => stage.reset());
    $("zoom-in").addEventListener("click", () => stage.eye.zoom(1.25));
    $("zoom-out").addEventListener("click", () => stage.eye.zoom(0.8));
    $("up").addEventListener("click", () => this.up(UPS[(UPS.indexOf(stage.up) + 1) % UPS.length]));
    $("picture").addEventListener("click", () => this.save());
    this.divide(0.5);
    this.drag($("divider"));
  }

  /** Show another display file, in the look that its address asks for. */
  load(display, look = {}) {
    this.display = display;
    this.stage.load(display);
    const file = $("colour-file").querySelector("input");
    file.disabled = !display.before.COLOR_0;
    $("colour-file").title = file.disabled ? "The file carries no colours" : "";
    this.size(0);
    this.look = look;
  }

  /** What an address says of the look; what is as usual is an empty text. */
  get look() {
    const { stage } = this;
    const unless = (usual, value) => (value === usual ? "" : String(value));
    return {
      view: unless("split", stage.view),
      shown: stage.view === "flip" ? unless("after", stage.shown) : "",
      split: unless(50, Math.round(stage.split * 100)),
      colour: unless("shaded", this.colouring),
      size: unless(0, Number($("size").value)),
      up: unless(stage.first?.up, stage.up),
      camera: stage.eye.text,
    };
  }

  set look({ view, shown, split, colour, size, up, camera }) {
    this.colour("shaded");
    if (colour) this.colour(colour);
    this.divide(Number(split || 50) / 100 || 0);
    this.size(Number(size) || 0);
    const wanted = UPS.includes(up) ? up : this.stage.first.up;
    if (wanted !== this.stage.up) this.up(wanted);
    this.stage.shown = shown === "before" ? "before" : "after";
    this.view(VIEWS.includes(view) ? view : "split");
    this.showUp();
    this.stage.reset();
    if (camera) this.stage.eye.text = camera;
  }

  /** Name the two sides of the picture. */
  name([before, after]) {
    for (const [side, text] of [["before", before], ["after", after]]) {
      $(`tag-${side}`).textContent = text;
      $(`flip-${side}`).textContent = text;
    }
    $("displacement").textContent = this.display.against ? "Difference" : "Displacement";
  }

  view(view) {
    for (const radio of radios("view")) radio.checked = radio.value === view;
    this.stage.set({ view });
    this.panel.dataset.view = view;
    if (view === "flip") this.flip(this.stage.shown);
    this.changed();
  }

  /** Show one cloud, the other one without an argument. */
  flip(shown = this.stage.shown === "after" ? "before" : "after") {
    this.stage.set({ shown });
    this.panel.dataset.shown = shown;
    $("flip").setAttribute("aria-label", `Showing ${shown}; press for the other`);
    this.changed();
  }

  colour(colouring) {
    const radio = radios("colour").find(({ value }) => value === colouring);
    if (!this.display || !radio || radio.disabled) return;
    radio.checked = true;
    this.colouring = colouring;
    this.stage.colour(coloured(this.display, colouring, this.stage.up));
    this.scale();
    this.changed();
  }

  /** Say what the colours mean. */
  scale() {
    if (this.display) showScale($("scale"), this.display, this.colouring, this.stage.up);
  }

  /** Set the size of points: ten steps are a factor of two. */
  size(steps) {
    const slider = $("size");
    slider.value = steps;
    const factor = 2 ** (Number(slider.value) / 10);
    $("size-value").textContent = `${factor.toFixed(1)} ×`;
    this.stage.set({ factor });
    this.changed();
  }

  up(up) {
    this.stage.turnUp(up);
    this.showUp();
    if (this.colouring === "height") this.colour("height");
    this.announce(`${up.toUpperCase()} is up`);
    this.changed();
  }

  showUp() {
    $("up").firstElementChild.textContent = this.stage.up.toUpperCase().replace("-", "−");
  }

  /** Put the divider at a share of the width. */
  divide(split) {
    const at = Math.min(1, Math.max(0, split));
    this.panel.style.setProperty("--split", `${at * 100}%`);
    $("divider").setAttribute("aria-valuenow", Math.round(at * 100));
    $("divider").setAttribute("aria-valuetext", `${Math.round(at * 100)} % before`);
    this.panel.dataset.hidden = at < 0.12 ? "before" : at > 0.88 ? "after" : "";
    this.stage.set({ split: at });
    this.changed();
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
      [["+", "=", "-"], "Closer, farther", (key) => stage.eye.zoom(key === "-" ? 0.8 : 1.25)],
      [["r"], "Fit the cloud", () => stage.reset()],
      [["x", "y", "z"], "Which axis is up, with Shift its other end", (key, shift) => this.up(shift ? `-${key}` : key)],
      [["p"], "Save a picture", () => this.save()],
    ];
  }

  arrow(key, shift) {
    const [right, up] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[key];
    if (shift) this.stage.eye.move(right * PUSH, up * PUSH);
    else this.stage.eye.turn(right * STEP, -up * STEP);
  }
}
