// Elements and numbers as text. What users wrote reaches the page as text content alone.

function el(tag, attributes = {}, ...children) {
  return filled(document.createElement(tag), attributes, children);
}

function svg(tag, attributes = {}, ...children) {
  return filled(document.createElementNS("http://www.w3.org/2000/svg", tag), attributes, children);
}

function filled(node, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else node.setAttribute(name, value === true ? "" : String(value));
  }
  for (const child of children) {
    if (child === null || child === undefined) continue;
    node.append(child instanceof Node ? child : document.createTextNode(String(child)));
  }
  return node;
}

// Six digits, a true minus.
function shown(value) {
  if (value === null || value === undefined || Number.isNaN(value)) return "—";
  if (!Number.isFinite(value)) return value > 0 ? "∞" : "−∞";
  const size = Math.abs(value);
  let text = "0";
  if (size >= 1e-4 && size < 1e6) text = String(Number(value.toPrecision(6)));
  else if (size > 0) text = String(Number(value.toPrecision(6)).toExponential());
  return text.replaceAll("-", "−").replace("e+", "e");
}

// A logarithm of a probability; what rounding left of zero is zero.
function nats(value) {
  return shown(Math.abs(value) < 1e-12 ? 0 : value);
}

function short(value) {
  if (!Number.isFinite(value)) return shown(value);
  return String(Number(value.toPrecision(3))).replaceAll("-", "−");
}

function thousands(value) {
  return value.toLocaleString("en-GB");
}

const counted = (value, noun) => `${thousands(value)} ${noun}${value === 1 ? "" : "s"}`;

// A cell of a table of numbers; all digits are in its title and its data.
function cell(value, text = shown(value)) {
  return el("td", { class: "number", title: String(value), "data-value": String(value) }, text);
}

// Texts of a column with their points one below the other.
function aligned(values) {
  const texts = values.map(shown);
  const after = texts.map((text) => {
    if (text.includes("e") || !/\d/.test(text)) return 0;
    const point = text.indexOf(".");
    return point < 0 ? 0 : text.length - point;
  });
  const widest = Math.max(0, ...after);
  return texts.map((text, k) => {
    const missing = widest - after[k];
    if (text.includes("e") || missing === 0) return text;
    // A point that is not there takes the room of a narrow space, each digit that of a figure.
    return text + (after[k] ? "" : "\u2008") + "\u2007".repeat(missing - (after[k] ? 0 : 1));
  });
}

function clipped(text, most) {
  return text.length <= most ? text : `${text.slice(0, most - 1)}…`;
}

// The width of a text on the page, in pixels.
const ruler = document.createElement("canvas").getContext("2d");
function measured(text, size = 12) {
  ruler.font = `${size}px ${getComputedStyle(document.body).fontFamily}`;
  return ruler.measureText(text).width;
}

// As many names as fit a width, and how many others there are; a long one is cut to eight letters
// or more, and nothing is said where they do not fit.
function fittedNames(names, width, size = 12) {
  if (!names.length) return "∅";
  const fits = (text) => measured(text, size) <= width;
  const others = (count) => (count < names.length ? ` +${names.length - count}` : "");
  for (let count = Math.min(names.length, 8); count > 0; count--) {
    const text = names.slice(0, count).join(", ") + others(count);
    if (text.length <= 40 && fits(text)) return text;
  }
  for (let most = 26; most >= 8; most--) {
    const text = clipped(names[0], most) + others(1);
    if (fits(text)) return text;
  }
  return "";
}

// As many names as fit, and how many others there are.
function listedNames(names, most = 26) {
  if (!names.length) return "∅";
  let count = names.length;
  let text = names.join(", ");
  while (text.length > most && count > 1) {
    count -= 1;
    text = `${names.slice(0, count).join(", ")} +${names.length - count}`;
  }
  return clipped(text, most);
}
