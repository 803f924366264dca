"use strict";
// The shapes of bodies at a frame, and surfaces as pixels: of triangles with stress at their corners the nearest one is seen.
const numbers = (text, Kind) => new Kind(Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer);

// Turned about the middle of the picture; rows of R are to the right, down and towards the eye.
class Turning {
  constructor(middle) { this.middle = middle; this.back(); }
  back() { this.R = [1, 0, 0, 0, 1, 0, 0, 0, 1]; }
  // by angles about the axes down and to the right of the picture as it is seen
  by(across, down) {
    const [c, s, d, t] = [Math.cos(across), Math.sin(across), Math.cos(down), Math.sin(down)];
    const more = [c, 0, s, -s * t, d, c * t, -s * d, -t, c * d], R = this.R;
    this.R = more.map((_, k) => [0, 1, 2].reduce((sum, j) => sum + more[3 * Math.floor(k / 3) + j] * R[3 * j + (k % 3)], 0));
  }
  of(places) {
    const R = this.R, [a, b, c] = this.middle;
    for (let k = 0; k < places.length; k += 3) {
      const x = places[k] - a, y = places[k + 1] - b, z = places[k + 2] - c;
      places[k] = a + R[0] * x + R[1] * y + R[2] * z;
      places[k + 1] = b + R[3] * x + R[4] * y + R[5] * z;
      places[k + 2] = c + R[6] * x + R[7] * y + R[8] * z;
    }
    return places;
  }
}

class Shape {
  constructor(entry, frames) {
    Object.assign(this, { n: entry.n, step: entry.step, lines: entry.lines, ends: entry.ends, kind: entry.kind });
    this.nodes = numbers(entry.nodes, Float32Array);
    this.motion = numbers(entry.motion, Float32Array);
    this.d = this.motion.length / frames / 3 - 1;
    this.turning = null;
    this.bend = entry.bend && numbers(entry.bend, Int16Array);
    this.asItIs = new Set(entry.as_it_is);
    this.shades = entry.shades && numbers(entry.shades, Uint8Array);
    this.triangles = entry.triangles && numbers(entry.triangles, Uint32Array);
    this.edges = entry.edges && numbers(entry.edges, Uint32Array);
    this.places = new Float32Array(3 * this.n);
    this.plain = [1, 3, 5].map((k) => parseInt(entry.colour.slice(k, k + 2), 16));
    if (this.triangles && this.d === 3) this.normals = this.normalsOf(this.triangles);
  }
  // of the undeformed body, of length one
  normalsOf(triangles) {
    const X = this.nodes, found = new Float32Array(triangles.length);
    for (let t = 0; t < triangles.length; t += 3) {
      const [a, b, c] = triangles.subarray(t, t + 3), side = (j, k) => X[3 * j + k] - X[3 * a + k];
      const normal = [1, 2, 0].map((k, j) => side(b, k) * side(c, 3 - j - k) - side(b, 3 - j - k) * side(c, k));
      const size = Math.hypot(...normal) || 1;
      normal.forEach((part, k) => (found[t + k] = part / size));
    }
    return found;
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
      const axes = this.turning ? 3 : 2;
      const gain = this.step * (this.asItIs.has(frame) ? 1 : factor), bend = this.bend.subarray(axes * n * frame);
      for (let k = 0; k < n; k++) for (let j = 0; j < axes; j++) places[3 * k + j] += gain * bend[axes * k + j];
    }
    return this.turning ? this.turning.of(places) : places;
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
    const wide = Math.max(1, Math.round(Math.min(wanted, Math.sqrt(1.6e6 / this.ratio))));
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
      this.triangles(shape, frame);
    }
    for (const shape of this.shapes) this.edges(shape, 6 * scale);
    this.context.putImageData(this.image, 0, 0);
  }
  triangles(shape, frame) {
    const { pixels, depth, palette } = this, { width, height } = this.image;
    const p = shape.places, t = shape.triangles, normals = shape.normals;
    const shades = shape.shades && shape.shades.subarray(frame * shape.n, (frame + 1) * shape.n);
    const m = shape.motion, R = shape.turning ? shape.turning.R.slice(6) : [0, 0, 1];
    const eye = shape.d < 3 ? null : [1, 2, 3].map((k) => R.reduce((sum, share, j) => sum + share * m[12 * frame + 4 * j + k], 0));
    const size = eye && Math.hypot(...eye);
    for (let k = 0; k < t.length; k += 3) {
      const a = 3 * t[k], b = 3 * t[k + 1], c = 3 * t[k + 2];
      const x0 = p[a], y0 = p[a + 1], x1 = p[b], y1 = p[b + 1], x2 = p[c], y2 = p[c + 1];
      const left = Math.max(0, Math.ceil(Math.min(x0, x1, x2) - 0.5)), right = Math.min(width - 1, Math.floor(Math.max(x0, x1, x2) - 0.5));
      const top = Math.max(0, Math.ceil(Math.min(y0, y1, y2) - 0.5)), bottom = Math.min(height - 1, Math.floor(Math.max(y0, y1, y2) - 0.5));
      const area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0);
      if (left > right || top > bottom || Math.abs(area) < 1e-9) continue;
      // a face along the line of sight is half as bright: its normal, of the undeformed body, turned with it
      const light = eye ? 0.5 + 0.5 * Math.abs(normals[k] * eye[0] + normals[k + 1] * eye[1] + normals[k + 2] * eye[2]) / size : 1;
      const s0 = shades ? shades[t[k]] : 255, s1 = shades ? shades[t[k + 1]] : 255, s2 = shades ? shades[t[k + 2]] : 255;
      const plain = s0 > 254 || s1 > 254 || s2 > 254;
      const own = shades ? palette[255] : shape.plain;
      // shares u, v of the corners 0 and 1 change by as much from pixel to pixel
      const du = (y1 - y2) / area, dv = (y2 - y0) / area;
      for (let y = top; y <= bottom; y++) {
        let u = ((x1 - left - 0.5) * (y2 - y - 0.5) - (x2 - left - 0.5) * (y1 - y - 0.5)) / area;
        let v = ((x2 - left - 0.5) * (y0 - y - 0.5) - (x0 - left - 0.5) * (y2 - y - 0.5)) / area;
        for (let x = left, at = y * width + left; x <= right; x++, at++, u += du, v += dv) {
          const w = 1 - u - v;
          if (u < -1e-4 || v < -1e-4 || w < -1e-4) continue;
          const z = u * p[a + 2] + v * p[b + 2] + w * p[c + 2];
          if (z < depth[at]) continue;
          depth[at] = z;
          const colour = plain ? own : palette[Math.max(0, Math.min(254, Math.round(u * s0 + v * s1 + w * s2)))];
          pixels[at] = 0xff000000 | ((colour[2] * light) << 16) | ((colour[1] * light) << 8) | (colour[0] * light);
        }
      }
    }
  }
  edges(shape, nearer) {
    const { pixels, depth, drawn } = this, { width, height } = this.image, p = shape.places, e = shape.edges;
    for (let k = 0; k < e.length; k += 2) {
      const a = 3 * e[k], b = 3 * e[k + 1];
      if (Math.max(p[a], p[b]) < 0 || Math.min(p[a], p[b]) > width || Math.max(p[a + 1], p[b + 1]) < 0 || Math.min(p[a + 1], p[b + 1]) > height) continue;
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
