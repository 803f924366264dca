"use strict";
// The shapes of bodies at a frame, and surfaces as pixels: of triangles with stress at their corners the nearest one is seen.
const numbers = (text, Kind) => new Kind(Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer);

class Shape {
  constructor(entry, frames) {
    Object.assign(this, { n: entry.n, step: entry.step, lines: entry.lines, ends: entry.ends, kind: entry.kind, colour: entry.colour });
    this.nodes = numbers(entry.nodes, Float32Array);
    this.motion = numbers(entry.motion, Float32Array);
    this.d = this.motion.length / frames / 3 - 1;
    this.bend = entry.bend && numbers(entry.bend, Int16Array);
    this.asItIs = new Set(entry.as_it_is);
    this.shades = entry.shades && numbers(entry.shades, Uint8Array);
    this.triangles = entry.triangles && numbers(entry.triangles, Uint32Array);
    this.edges = entry.edges && numbers(entry.edges, Uint32Array);
    this.places = new Float32Array(3 * this.n);
  }
  // x = p + D X + factor * u: to the right, down, towards the eye
  at(frame, factor) {
    const { n, d, nodes, places } = this, wide = 1 + d;
    const motion = this.motion.subarray(3 * wide * frame, 3 * wide * (frame + 1));
    for (let k = 0; k < n; k++)
      for (let row = 0; row < 3; row++) {
        let sum = motion[row * wide];
        for (let j = 0; j < d; j++) sum += motion[row * wide + 1 + j] * nodes[k * d + j];
        places[3 * k + row] = sum;
      }
    if (this.bend) {
      const gain = this.step * (this.asItIs.has(frame) ? 1 : factor), bend = this.bend.subarray(2 * n * frame);
      for (let k = 0; k < n; k++) {
        places[3 * k] += gain * bend[2 * k];
        places[3 * k + 1] += gain * bend[2 * k + 1];
      }
    }
    return places;
  }
  shade(frame, node) { return this.shades[frame * this.n + node]; }
}

// 254 shades between the stops, and grey for what is not known
const paletteOf = (stops) => {
  const parts = stops.map((stop) => [1, 3, 5].map((k) => parseInt(stop.slice(k, k + 2), 16)));
  const shades = [];
  for (let k = 0; k < 255; k++) {
    const place = (k / 254) * (parts.length - 1), low = Math.min(Math.floor(place), parts.length - 2);
    shades.push(parts[low].map((part, j) => part + (place - low) * (parts[low + 1][j] - part)));
  }
  return [...shades, [107, 107, 107]];
};
const css = (colour) => `rgb(${colour.map(Math.round).join()})`;

class Surfaces {
  constructor(canvas, shapes, width, height, palette) {
    Object.assign(this, { canvas, palette, ratio: height / width });
    this.shapes = shapes.filter((shape) => shape.triangles);
    this.context = canvas.getContext("2d", { willReadFrequently: true }); // pixels are made here, not on a card
  }
  resize() {
    const wanted = this.canvas.clientWidth * Math.max(2, devicePixelRatio || 1);
    const wide = Math.max(1, Math.round(Math.min(wanted, Math.sqrt(2.5e6 / this.ratio))));
    if (this.image && this.image.width === wide) return;
    this.canvas.width = wide;
    this.canvas.height = Math.max(1, Math.round(wide * this.ratio));
    this.image = this.context.createImageData(wide, this.canvas.height);
    this.pixels = new Uint32Array(this.image.data.buffer);
    this.depth = new Float32Array(this.pixels.length);
    this.drawn = new Uint8Array(this.pixels.length);
  }
  // what of the picture is seen: its left upper corner and its width
  draw(frame, factor, seen) {
    this.resize();
    this.pixels.fill(0);
    this.depth.fill(-Infinity);
    this.drawn.fill(0);
    const scale = this.image.width / seen.width;
    for (const shape of this.shapes) {
      const places = shape.at(frame, factor);
      for (let k = 0; k < places.length; k += 3) {
        places[k] = (places[k] - seen.x) * scale;
        places[k + 1] = (places[k + 1] - seen.y) * scale;
        places[k + 2] *= scale;
      }
      for (let t = 0; t < shape.triangles.length; t += 3) this.triangle(shape, frame, t);
    }
    for (const shape of this.shapes) this.edges(shape, 6 * scale);
    this.context.putImageData(this.image, 0, 0);
  }
  // a face along the line of sight is half as bright: its normal, of the undeformed body, turned with it
  light(shape, frame, a, b, c) {
    if (shape.d < 3) return 1;
    const X = shape.nodes, side = (j, k) => X[3 * j + k] - X[3 * a + k];
    const normal = [0, 1, 2].map((k) => side(b, (k + 1) % 3) * side(c, (k + 2) % 3) - side(b, (k + 2) % 3) * side(c, (k + 1) % 3));
    const eye = shape.motion.subarray(12 * frame + 9, 12 * frame + 12);
    const size = Math.hypot(...normal) * Math.hypot(...eye);
    return 0.5 + 0.5 * Math.abs((normal[0] * eye[0] + normal[1] * eye[1] + normal[2] * eye[2]) / (size || 1));
  }
  triangle(shape, frame, t) {
    const { pixels, depth, palette } = this, { width, height } = this.image, p = shape.places;
    const [a, b, c] = shape.triangles.subarray(t, t + 3);
    const x0 = p[3 * a], y0 = p[3 * a + 1], x1 = p[3 * b], y1 = p[3 * b + 1], x2 = p[3 * c], y2 = p[3 * c + 1];
    const area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0);
    if (Math.abs(area) < 1e-9) return;
    const light = this.light(shape, frame, a, b, c);
    const s = shape.shades ? [shape.shade(frame, a), shape.shade(frame, b), shape.shade(frame, c)] : null;
    const unknown = s && Math.max(...s) > 254;
    const plain = s ? palette[255] : [1, 3, 5].map((k) => parseInt(shape.colour.slice(k, k + 2), 16));
    const left = Math.max(0, Math.ceil(Math.min(x0, x1, x2) - 0.5)), right = Math.min(width - 1, Math.floor(Math.max(x0, x1, x2) - 0.5));
    const top = Math.max(0, Math.ceil(Math.min(y0, y1, y2) - 0.5)), bottom = Math.min(height - 1, Math.floor(Math.max(y0, y1, y2) - 0.5));
    for (let y = top; y <= bottom; y++)
      for (let x = left; x <= right; x++) {
        const u = ((x1 - x - 0.5) * (y2 - y - 0.5) - (x2 - x - 0.5) * (y1 - y - 0.5)) / area;
        const v = ((x2 - x - 0.5) * (y0 - y - 0.5) - (x0 - x - 0.5) * (y2 - y - 0.5)) / area;
        const w = 1 - u - v;
        if (u < -1e-4 || v < -1e-4 || w < -1e-4) continue;
        const at = y * width + x, z = u * p[3 * a + 2] + v * p[3 * b + 2] + w * p[3 * c + 2];
        if (z < depth[at]) continue;
        depth[at] = z;
        const colour = s && !unknown ? palette[Math.max(0, Math.min(254, Math.round(u * s[0] + v * s[1] + w * s[2])))] : plain;
        pixels[at] = 0xff000000 | ((colour[2] * light) << 16) | ((colour[1] * light) << 8) | (colour[0] * light);
      }
  }
  edges(shape, nearer) {
    const { pixels, depth, drawn } = this, { width, height } = this.image, p = shape.places, e = shape.edges;
    for (let k = 0; k < e.length; k += 2) {
      const a = 3 * e[k], b = 3 * e[k + 1];
      const steps = Math.ceil(Math.max(Math.abs(p[b] - p[a]), Math.abs(p[b + 1] - p[a + 1]), 1));
      for (let j = 0; j <= steps; j++) {
        const share = j / steps, x = Math.floor(p[a] + share * (p[b] - p[a])), y = Math.floor(p[a + 1] + share * (p[b + 1] - p[a + 1]));
        const at = y * width + x;
        if (x < 0 || y < 0 || x >= width || y >= height || drawn[at] || p[a + 2] + share * (p[b + 2] - p[a + 2]) + nearer < depth[at]) continue;
        drawn[at] = 1;
        const own = pixels[at], mixed = (shift) => ((0.5 * ((own >> shift) & 255) + 0.5 * 58) << shift);
        pixels[at] = own === 0 ? 0xff3a3a3a : 0xff000000 | mixed(16) | mixed(8) | mixed(0);
      }
    }
  }
}
