// What the colours mean: a bar with its ends, and the histogram of displacements.

import { MAPS, along, heights } from "./colouring.js";
import { length, unitNote } from "./units.js";

const NS = "http://www.w3.org/2000/svg";

function svg(tag, attributes, ...children) {
  const element = document.createElementNS(NS, tag);
  for (const [name, given] of Object.entries(attributes)) element.setAttribute(name, given);
  element.append(...children);
  return element;
}

function note(text) {
  const element = document.createElement("p");
  element.textContent = text;
  return element;
}

function colourOf(map, share) {
  const at = Math.round(Math.min(1, Math.max(0, share)) * 255) * 3;
  return `rgb(${map[at]} ${map[at + 1]} ${map[at + 2]})`;
}

function bar(map) {
  const stops = Array.from({ length: 17 }, (_, index) =>
    svg("stop", { offset: `${(index / 16) * 100}%`, "stop-color": colourOf(map, index / 16) }));
  return svg("svg", { class: "bar", viewBox: "0 0 100 10", preserveAspectRatio: "none", "aria-hidden": "true" },
    svg("linearGradient", { id: "scale-gradient" }, ...stops),
    svg("rect", { width: 100, height: 10, fill: "url(#scale-gradient)" }));
}

function ends(...texts) {
  const element = document.createElement("div");
  element.className = "ends";
  for (const text of texts) {
    const end = document.createElement("span");
    end.textContent = text;
    element.append(end);
  }
  return element;
}

function histogram({ histogram: counts, p99, median, p95 }) {
  const highest = Math.max(...counts, 1);
  const width = 100 / counts.length;
  const bars = counts.map((count, index) => svg("rect", {
    x: index * width, width: width * 0.86, y: 40 - (count / highest) * 38, height: (count / highest) * 38,
    fill: colourOf(MAPS.displacement, (index + 0.5) / counts.length),
  }));
  const marks = [median, p95].filter((at) => p99 > 0 && at <= p99).map((at) => {
    const x = (at / p99) * 100;
    return svg("line", { x1: x, x2: x, y1: 0, y2: 40, class: "mark", "vector-effect": "non-scaling-stroke" });
  });
  return svg("svg", { class: "histogram", viewBox: "0 0 100 40", preserveAspectRatio: "none", role: "img",
    "aria-label": `Histogram of displacements: median ${length(median)}, 95 per cent below ${length(p95)}` },
    ...bars, ...marks);
}

/** Fill `element` for a colouring of a display file. */
export function showScale(element, display, colouring, up) {
  element.dataset.colouring = colouring;
  if (colouring === "displacement") {
    const { displacement } = display;
    element.replaceChildren(histogram(displacement), bar(MAPS.displacement), ends("0", length(displacement.p99)),
      note([display.against ? "How far the two results lie apart" : "How far points moved", unitNote(),
        "up to the 99th percentile. Lines: median and 95 %."].filter(Boolean).join(", ")));
  } else if (colouring === "height") {
    const { axis, sign } = along(up);
    const [low, high] = heights(display, up).map((height) => height * sign + display.centre[axis]);
    element.replaceChildren(bar(MAPS.height), ends(length(low), length(high)),
      note([`${"XYZ"[axis]} ${unitNote()}`.trim(), "from the 1st to the 99th percentile."].join(", ")));
  } else if (colouring === "normal") {
    const swatches = document.createElement("div");
    swatches.className = "swatches";
    for (const axis of ["x", "y", "z"]) {
      const swatch = document.createElement("span");
      swatch.className = axis;
      swatch.textContent = axis.toUpperCase();
      swatches.append(swatch);
    }
    element.replaceChildren(swatches, note("Where the normal points, whichever its sign. Before: estimated from the noisy points."));
  } else if (colouring === "file") {
    element.replaceChildren(note("The colours the file carries, lit by each point's normal."));
  } else {
    element.replaceChildren(note("One colour, lit by each point's normal: noise shows as grain."));
  }
}
