// Elements of the page: found, changed and made.

export const byId = (id) => document.getElementById(id);

/** Set a property of an element, only when it changes. */
export function put(element, name, value) {
  if (element[name] !== value) element[name] = value;
}

/** New rows for a list, or a text if there are none; keyboard focus is kept. */
export function refill(list, rows, empty, down = 0) {
  const parts = () => [...list.querySelectorAll("input, button")];
  const at = parts().indexOf(document.activeElement), wide = parts().length / list.childElementCount;
  if (!rows.length) {
    rows.push(document.createElement("li"));
    rows[0].className = "quiet";
    rows[0].textContent = empty;
  }
  list.replaceChildren(...rows);
  if (at < 0) return;
  const now = parts(), next = now.slice(Math.min(at + down * wide, now.length - 1));
  (next.find((part) => !part.disabled) ?? list.closest("details").querySelector("summary")).focus();
}

/** A small button with an accessible name. */
export function button(text, name, press, disabled = false) {
  const made = document.createElement("button");
  made.type = "button";
  Object.assign(made, { textContent: text, ariaLabel: name, title: name, disabled });
  made.addEventListener("click", press);
  return made;
}
