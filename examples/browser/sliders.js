// The sliders of material, air and gravity.

import { short } from "./plot.js";

// Field, label, unit, range, and whether the slider goes by powers of ten.
const SLIDERS = [
  ["stretch", "Stretch modulus", "N/m", 10, 1e5, true],
  ["shear", "Shear modulus", "N/m", 1, 1e4, true],
  ["bend", "Bending stiffness", "N m", 1e-6, 1e-1, true],
  ["density", "Mass per area", "kg/m\u00b2", 0.02, 2, true],
  ["gravity", "Gravity", "m/s\u00b2", 0, 20, false],
  ["wind", "Wind", "m/s", 0, 15, false],
  ["wind_direction", "Wind blows to, from above", "\u00b0", 0, 360, false],
];
const STEPS = 200;

/** Builds the sliders in a fieldset; `set(field, value)` is called when one moves. Returns a function that shows values. */
export function build(fieldset, set) {
  const shown = new Map();
  for (const [field, name, unit, low, high, powers] of SLIDERS) {
    const [from, to] = powers ? [Math.log10(low), Math.log10(high)] : [low, high];
    const label = Object.assign(document.createElement("label"), { htmlFor: field });
    const value = Object.assign(document.createElement("output"), { htmlFor: field });
    const input = Object.assign(document.createElement("input"), { id: field, type: "range", min: 0, max: STEPS, step: 1 });
    label.append(name, value);
    fieldset.append(label, input);
    const say = (number) => {
      value.textContent = `${short(number)} ${unit}`;
      input.setAttribute("aria-valuetext", value.textContent);
    };
    input.addEventListener("input", () => {
      const at = from + ((to - from) * input.valueAsNumber) / STEPS;
      const number = powers ? 10 ** at : at;
      say(number);
      set(field, number);
    });
    shown.set(field, (number) => {
      const at = powers ? Math.log10(Math.max(number, low)) : number;
      input.value = Math.round((STEPS * (at - from)) / (to - from));
      say(number);
    });
  }
  return (values) => shown.forEach((show, field) => field in values && show(values[field]));
}
