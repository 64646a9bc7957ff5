// Numbers as people type and read them.

/** x, y, heading with two decimals and true minus-free zeros. */
export const words = (values) => values.map((value) => (Math.round(value * 100) / 100 || 0).toFixed(2)).join(", ");

/** That many finite numbers in a text; null when it holds anything else. */
export function numbers(text, count) {
  const found = text.trim().split(/[\s,;]+/).map(Number);
  return text.trim() && found.length === count && found.every(Number.isFinite) ? found : null;
}

export const round3 = (values) => values.map((value) => Math.round(value * 1000) / 1000 || 0);
