// A picture on a canvas with axes, which is panned and zoomed.

class Plot {
  constructor(canvas) {
    this.canvas = canvas;
    this.zoomed = null;
    this.listen();
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  draw() {
    const box = this.canvas.getBoundingClientRect();
    if (box.width < 2 || !this.option) return;
    const ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.round(box.width * ratio);
    this.canvas.height = Math.round(box.height * ratio);
    this.pen = this.canvas.getContext("2d");
    this.pen.scale(ratio, ratio);
    this.pen.font = `11px ${getComputedStyle(this.canvas).fontFamily}`;
    this.size = { width: box.width, height: box.height };
    this.ink = colours(this.canvas);
    this.drawn();
  }

  frame(x, y, xNames, yNames, least = 36) {
    const pad = { left: 58, right: 16, top: 12, bottom: Math.max(least, 36) };
    const { width, height } = this.size;
    const across = width - pad.left - pad.right;
    const down = height - pad.top - pad.bottom;
    this.at = {
      pad, across, down, limits: [x, y],
      x: (value) => pad.left + (value - x[0]) / (x[1] - x[0]) * across,
      y: (value) => height - pad.bottom - (value - y[0]) / (y[1] - y[0]) * down,
      value: (px, py) => [x[0] + (px - pad.left) / across * (x[1] - x[0]), y[0] + (height - pad.bottom - py) / down * (y[1] - y[0])],
    };
    const { pen, ink } = this;
    pen.clearRect(0, 0, width, height);
    pen.strokeStyle = ink.grid;
    pen.fillStyle = ink.muted;
    pen.lineWidth = 1;
    const xs = ticks(x[0], x[1], Math.max(3, Math.round(across / 90)));
    const ys = yNames === null ? [] : ticks(y[0], y[1], Math.max(3, Math.round(down / 60)));
    pen.beginPath();
    pen.textAlign = "center";
    for (const value of xs) {
      pen.moveTo(this.at.x(value), pad.top);
      pen.lineTo(this.at.x(value), height - pad.bottom);
      pen.fillText(tickText(value, xs[1] - xs[0] || 1), this.at.x(value), height - pad.bottom + 15);
    }
    pen.textAlign = "right";
    for (const value of ys) {
      pen.moveTo(pad.left, this.at.y(value));
      pen.lineTo(width - pad.right, this.at.y(value));
      pen.fillText(tickText(value, ys[1] - ys[0] || 1), pad.left - 7, this.at.y(value) + 4);
    }
    pen.stroke();
    pen.textAlign = "center";
    pen.fillStyle = ink.text;
    pen.fillText(xNames, pad.left + 0.5 * across, height - pad.bottom + 31);
    if (yNames !== null) {
      pen.save();
      pen.translate(13, pad.top + 0.5 * down);
      pen.rotate(-0.5 * Math.PI);
      pen.fillText(yNames, 0, 0);
      pen.restore();
    }
    pen.save();
    pen.beginPath();
    pen.rect(pad.left, pad.top, across, down);
    pen.clip();
  }

  line(xs, ys, colour, dash, width, first = 0) {
    const { pen, at } = this;
    pen.beginPath();
    let drawn = false;
    for (let k = first; k < xs.length; k++) {
      const known = Number.isFinite(xs[k]) && Number.isFinite(ys[k]);
      if (known) pen[drawn ? "lineTo" : "moveTo"](at.x(xs[k]), at.y(ys[k]));
      drawn = known;
    }
    pen.strokeStyle = colour;
    pen.lineWidth = width;
    pen.setLineDash(dash);
    pen.lineJoin = "round";
    pen.stroke();
    pen.setLineDash([]);
  }

  mark(x, y) {
    const { pen, ink } = this;
    this.canvas.dataset.x = x.toFixed(1);
    this.canvas.dataset.y = y.toFixed(1);
    pen.beginPath();
    pen.arc(x, y, 5, 0, 7);
    pen.fillStyle = ink.second;
    pen.fill();
    pen.lineWidth = 2;
    pen.strokeStyle = ink.paper;
    pen.stroke();
  }

  listen() {
    let from = null;
    let moved = false;
    const where = (event) => {
      const box = this.canvas.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    };
    this.canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const [px, py] = where(event);
      const centre = this.at.value(px, py);
      const factor = Math.exp(0.0015 * event.deltaY);
      this.zoomed = this.at.limits.map(([low, high], k) => [centre[k] + factor * (low - centre[k]), centre[k] + factor * (high - centre[k])]);
      this.draw();
    }, { passive: false });
    this.canvas.addEventListener("pointerdown", (event) => {
      from = { at: where(event), limits: this.at.limits };
      moved = false;
    });
    this.canvas.addEventListener("pointermove", (event) => {
      if (!from) return;
      const [px, py] = where(event);
      if (!moved && Math.hypot(px - from.at[0], py - from.at[1]) < 4) return;
      if (!moved) this.canvas.setPointerCapture(event.pointerId);
      moved = true;
      const [[x0, x1], [y0, y1]] = from.limits;
      const dx = (px - from.at[0]) / this.at.across * (x1 - x0);
      const dy = (py - from.at[1]) / this.at.down * (y1 - y0);
      this.zoomed = [[x0 - dx, x1 - dx], [y0 + dy, y1 + dy]];
      this.draw();
    });
    this.canvas.addEventListener("pointerup", (event) => {
      if (from && !moved) this.clicked(...where(event));
      from = null;
    });
    this.canvas.addEventListener("pointercancel", () => {
      from = null;
    });
  }
}

// The range of means and their deviations.
function spanOf(values, variances) {
  let low = Infinity;
  let high = -Infinity;
  for (let k = 0; k < values.length; k++) {
    const std = Math.sqrt(Math.max(variances[k], 0));
    if (!Number.isFinite(values[k] + std)) continue;
    low = Math.min(low, values[k] - 2.5 * std);
    high = Math.max(high, values[k] + 2.5 * std);
  }
  if (!(low < high)) return Number.isFinite(low) ? [low - 1, low + 1] : [0, 1];
  const pad = 0.04 * (high - low);
  return [low - pad, high + pad];
}

function colours(node) {
  const style = getComputedStyle(node);
  const of = (name) => style.getPropertyValue(`--${name}`).trim();
  return { text: of("belief"), muted: of("muted"), grid: of("grid"), first: of("first"), second: of("second"), third: of("third"), fourth: of("fourth"), soft: of("soft"), paper: of("paper") };
}
