// A curve of the last frames in a small canvas.

const LENGTH = 240;

/** Returns a number with three digits. */
export function short(value) {
  if (value === null || !Number.isFinite(value)) return "-";
  const size = Math.abs(value);
  return size !== 0 && (size < 1e-3 || size >= 1e5) ? value.toExponential(1) : String(Number(value.toPrecision(3)));
}

export class Plot {
  /** `logarithmic` shows powers of ten; values that are not above 0 are then left out. */
  constructor(canvas, logarithmic) {
    Object.assign(this, { canvas, logarithmic, values: [], label: canvas.getAttribute("aria-label") });
  }

  clear() {
    this.values = [];
    this.draw();
  }

  push(value) {
    this.values.push(value);
    this.values.splice(0, this.values.length - LENGTH);
  }

  draw() {
    const { canvas, logarithmic } = this;
    const scale = window.devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    [canvas.width, canvas.height] = [width * scale, height * scale].map(Math.round);
    const pen = canvas.getContext("2d");
    pen.scale(scale, scale);
    const shown = this.values.map((v) => (v === null || (logarithmic && v <= 0) ? null : logarithmic ? Math.log10(v) : v));
    const known = shown.filter((v) => v !== null && Number.isFinite(v));
    const last = this.values.at(-1) ?? null;
    canvas.setAttribute("aria-label", `${this.label}: ${short(last)} in the last one`);
    if (known.length === 0) return;
    let [low, high] = [Math.min(...known), Math.max(...known)];
    const least = logarithmic ? 1 : 1e-3 * Math.max(Math.abs(high), 1e-12);
    if (high - low < least) [low, high] = [(low + high - least) / 2, (low + high + least) / 2];
    const style = getComputedStyle(canvas);
    const x = (k) => (width * (k + LENGTH - shown.length)) / (LENGTH - 1);
    const y = (v) => height - 6 - ((height - 12) * (v - low)) / (high - low);
    pen.strokeStyle = style.color;
    pen.lineWidth = 1.5;
    pen.beginPath();
    let drawing = false;
    shown.forEach((v, k) => {
      if (v === null || !Number.isFinite(v)) drawing = false;
      else if (drawing) pen.lineTo(x(k), y(v));
      else {
        pen.moveTo(x(k), y(v));
        drawing = true;
      }
    });
    pen.stroke();
    pen.fillStyle = getComputedStyle(document.body).color;
    pen.font = "12px system-ui, sans-serif";
    const of = (v) => short(logarithmic ? 10 ** v : v);
    pen.fillText(of(high), 5, 14);
    pen.fillText(of(low), 5, height - 5);
    pen.textAlign = "right";
    pen.fillText(short(last), width - 5, 14);
  }
}
