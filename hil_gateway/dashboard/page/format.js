// Numbers, times and small pieces of the document, the same everywhere on the page.
export const byId = (id) => document.getElementById(id);
export const known = (value) => value !== null && value !== undefined;
export const fixed = (value, digits, unit = "") => (known(value) ? value.toFixed(digits).replace(/^-(0\.?0*)$/, "$1") + (unit && ` ${unit}`) : "–");
export const short = (value) => (Math.abs(value) >= 1000 ? value.toFixed(0) : Number(value.toPrecision(3)).toString());
export const words = (text) => text.replaceAll("_", " ");
export const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

export function lapTime(seconds) {
  if (!known(seconds)) return "–";
  const minutes = Math.floor(seconds / 60);
  const rest = (seconds - 60 * minutes).toFixed(2);
  return minutes ? `${minutes}:${rest.padStart(5, "0")}` : `${rest} s`;
}

export const signed = (value, digits, unit) => (known(value) ? `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(digits)} ${unit}` : "–");

export const lapGap = (seconds) => (known(seconds) ? `${seconds < 0 ? "−" : "+"}${lapTime(Math.abs(seconds))}` : "–");

export function row(cells, classes = [], name = "") {
  const tr = document.createElement("tr");
  tr.className = name;
  cells.forEach((cell, i) => {
    const td = document.createElement("td");
    if (cell instanceof Node) td.append(cell);
    else td.textContent = cell;
    if (classes[i]) td.className = classes[i];
    tr.append(td);
  });
  return tr;
}

export const fill = (id, rows) => byId(id).querySelector("tbody").replaceChildren(...rows);

export function item(text, name = "") {
  const li = document.createElement("li");
  li.textContent = text;
  li.className = name;
  return li;
}

export function shape(name, attributes) {
  const node = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  return node;
}
