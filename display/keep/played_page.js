"use strict";
// Shows a play that played_page.py has written. A worker decodes it, carries the Gaussians of bodies along with their
// cages, and sorts; this thread draws and takes the user's hands. Lengths in metres, +y up; quaternions wxyz.

const get = (id) => document.getElementById(id);
const picture = get("picture"), slider = get("slider");
const HINT_SECONDS = 12, END_SECONDS = 1;  // how long the hint is shown, how long the last moment before it starts again
const NEAREST = 0.05, FARTHEST = 3;  // [m] from the target; in multiples of the first distance, which is in a room
const STEEPEST = 1.54, LOWEST = 0.05;  // [rad] above the target: in a room that stands on something
const TURN_PER_PIXEL = 0.006, ZOOM_PER_PIXEL = 0.0012;  // [rad], [-]
const WIDEST = 1.25;  // narrower pages keep the horizontal angle of this ratio of width to height
const PIXELS_MAX = 2;  // device pixels per CSS pixel: more cost time and show nothing
const ROW = 1024;  // Gaussians in a row of the textures

// ---------------------------------------------------------------- the worker: what is where, and in which order

function work() {
  const ROW = 1024, MAX_STRETCH = 4, PLAIN = 2;  // as below, as in sim/embedding.py, in place of x if all SH are 0
  let play, tracks, colours, floats, shade, changes, ids, distances;
  let shadeAt = -1, sortedFor = "";

  const inflate = async (bytes) => new Uint8Array(await new Response(
    new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer());

  // Write Gaussian g of a SPZ 3, whose y and z point the other way, to slot s of the layers.
  // Floats: mean and xx; xy, xz, yy, yz; zz and x, y, z of the turn of the harmonics. Bytes: colour and opacity, then SH.
  function spz(bytes) {
    const head = new DataView(bytes.buffer), n = head.getUint32(8, true), unit = 2 ** -bytes[13];
    const K = (bytes[12] + 1) ** 2 - 1, at = [16], q = [0, 0, 0, 0];
    for (const width of [9, 1, 3, 3, 4]) at.push(at[at.length - 1] + n * width);
    return { n, K, read(g, s, area) {
      const f = 4 * s, F = 4 * area;
      for (let c = 0; c < 3; c++) {
        const p = at[0] + 9 * g + 3 * c, fixed = (bytes[p] | bytes[p + 1] << 8 | bytes[p + 2] << 16) << 8 >> 8;
        floats[f + c] = fixed * unit * (c ? -1 : 1);
        colours[f + c] = bytes[at[2] + 3 * g + c];
      }
      colours[f + 3] = bytes[at[1] + g];
      const code = head.getUint32(at[4] + 4 * g, true), largest = code >>> 30;
      let rest = 1;
      for (let c = 0, shift = 20; c < 4; c++) {
        if (c === largest) continue;
        const field = code >>> shift;
        q[c] = (field & 511) / 511 * Math.SQRT1_2 * (field & 512 ? -1 : 1);
        rest -= q[c] * q[c];
        shift -= 10;
      }
      q[largest] = Math.sqrt(Math.max(0, rest));
      const x = q[0], y = -q[1], z = -q[2], w = q[3];
      const R = [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)];
      const v = [0, 1, 2].map((c) => Math.exp(2 * (bytes[at[3] + 3 * g + c] / 16 - 10)));
      const S = (i, j) => R[i] * R[j] * v[0] + R[i + 1] * R[j + 1] * v[1] + R[i + 2] * R[j + 2] * v[2];
      floats[f + 3] = S(0, 0); floats[F + f] = S(0, 3); floats[F + f + 1] = S(0, 6); floats[F + f + 2] = S(3, 3);
      floats[F + f + 3] = S(3, 6); floats[2 * F + f] = S(6, 6);
      floats[2 * F + f + 1] = PLAIN;
      for (let k = 0; k < 3 * K; k++) {
        const byte = colours[F * (1 + Math.floor(k / 3)) + f + k % 3] = bytes[at[5] + 3 * K * g + k];
        if (byte !== 128) floats[2 * F + f + 1] = 0;
      }
    } };
  }

  async function open(scene, motion) {
    const data = await inflate(motion);
    let at = 4 + new DataView(data.buffer).getUint32(0, true);
    const take = (Type, n) => new Type(data.slice(at, at += n * Type.BYTES_PER_ELEMENT).buffer);
    play = JSON.parse(new TextDecoder().decode(data.subarray(4, at)));
    const gaussians = spz(await inflate(scene));
    tracks = play.tracks;
    let count = play.still, first = play.still;  // slots, and Gaussians in the file, where a look is there once
    for (const t of tracks) {
      t.slot = count;
      count += t.count;
    }
    const area = ROW * Math.ceil(Math.max(count, 1) / ROW);
    floats = new Float32Array(12 * area);
    colours = new Uint8Array(4 * area * (1 + gaussians.K));
    for (let g = 0; g < play.still; g++) gaussians.read(g, g, area);
    for (const t of tracks) {
      t.own = tracks[t.look];
      if (t.own === t) {
        Object.assign(t, { begin: first, tets: take(Uint32Array, 4 * t.tets), host: take(Uint32Array, 4 * t.count) });
        t.weights = take(Int16Array, 12 * t.count);
        first += t.count;
      }
      for (let g = 0; g < t.count; g++) gaussians.read(t.own.begin + g, t.slot + g, area);
      const size = 3 * t.vertices, low = take(Uint8Array, t.frames * size), high = take(Uint8Array, t.frames * size);
      t.x = new Float64Array(size).fill(NaN);
      t.path = new Uint16Array(t.frames * size);
      for (let i = 0; i < t.path.length; i++) t.path[i] = (i < size ? 0 : t.path[i - size]) + (low[i] | high[i] << 8);
      if (t.own === t) rest(t, area);
    }
    changes = play.changes.map((n) => [take(Uint8Array, Math.ceil(count / 8)), take(Uint8Array, n)]);
    shade = new Uint8Array(area).fill(255);
    ids = new Uint32Array(count);
    distances = new Float32Array(count);
    postMessage({ play, area, layers: 1 + gaussians.K, floats: floats.slice(), colours });
  }

  // Corners of the local tetrahedron of Gaussian g, y_k = sum_j W_kj x_j, to y.
  function corners(own, g, x, y) {
    for (let k = 0; k < 4; k++) {
      const tet = 4 * own.host[4 * g + k], w = 12 * g + 3 * k;
      const w0 = own.weights[w] * own.unit, w1 = own.weights[w + 1] * own.unit, w2 = own.weights[w + 2] * own.unit;
      const w3 = 1 - w0 - w1 - w2;
      const a = 3 * own.tets[tet], b = 3 * own.tets[tet + 1], c = 3 * own.tets[tet + 2], d = 3 * own.tets[tet + 3];
      for (let i = 0; i < 3; i++) y[3 * k + i] = w0 * x[a + i] + w1 * x[b + i] + w2 * x[c + i] + w3 * x[d + i];
    }
  }

  // Keep D^-1, the offset of the mean from the centroid and Sigma of each Gaussian, at the track's first keyframe.
  function rest(t, area) {
    const y = new Float64Array(12), F = 4 * area;
    pose(t, 0, 0);
    t.inverse = new Float64Array(9 * t.count);
    t.offset = new Float32Array(3 * t.count);
    t.sigma = new Float32Array(6 * t.count);
    for (let g = 0; g < t.count; g++) {
      corners(t, g, t.x, y);
      const [a, b, c, d, e, f, h, i, j] = [0, 1, 2].flatMap((r) => [3, 6, 9].map((k) => y[k + r] - y[r]));
      const det = a * (e * j - f * i) - b * (d * j - f * h) + c * (d * i - e * h);
      const adjugate = [e * j - f * i, c * i - b * j, b * f - c * e, f * h - d * j, a * j - c * h, c * d - a * f,
        d * i - e * h, b * h - a * i, a * e - b * d];
      for (let k = 0; k < 9; k++) t.inverse[9 * g + k] = adjugate[k] / det;
      const s = 4 * (t.slot + g);
      for (let r = 0; r < 3; r++) t.offset[3 * g + r] = floats[s + r] - (y[r] + y[3 + r] + y[6 + r] + y[9 + r]) / 4;
      t.sigma.set([floats[s + 3], ...floats.subarray(F + s, F + s + 4), floats[2 * F + s]], 6 * g);
    }
    t.x.fill(NaN);
  }

  // Put the vertices of a track between two of its keyframes; returns whether any has moved.
  function pose(t, a, mix) {
    const size = t.x.length, from = a * size, to = Math.min(a + 1, t.frames - 1) * size;
    let moved = false;
    for (let i = 0; i < size; i++) {
      const c = i % 3, p = t.path[from + i], at = t.low[c] + t.step[c] * (p + (t.path[to + i] - p) * mix);
      moved = moved || t.x[i] !== at;
      t.x[i] = at;
    }
    return moved;
  }

  // F = [y1-y0, y2-y0, y3-y0] D^-1,  mu = mean(y) + F offset,  Sigma = F Sigma_0 F^T      VR-GS, Sec. 4.3.2
  function carry(t, area) {
    const own = t.own, y = new Float64Array(12), M = new Float64Array(9), T = new Float64Array(9), F = 4 * area;
    for (let g = 0; g < t.count; g++) {
      corners(own, g, t.x, y);
      const D = 9 * g, o = 3 * g, S = own.sigma, z = 6 * g, s = 4 * (t.slot + g);
      for (let r = 0; r < 3; r++) {
        const e0 = y[3 + r] - y[r], e1 = y[6 + r] - y[r], e2 = y[9 + r] - y[r];
        for (let c = 0; c < 3; c++) {
          M[3 * r + c] = e0 * own.inverse[D + c] + e1 * own.inverse[D + 3 + c] + e2 * own.inverse[D + 6 + c];
        }
        const a = M[3 * r], b = M[3 * r + 1], c = M[3 * r + 2];
        floats[s + r] = (y[r] + y[3 + r] + y[6 + r] + y[9 + r]) / 4
          + a * own.offset[o] + b * own.offset[o + 1] + c * own.offset[o + 2];
        T[3 * r] = a * S[z] + b * S[z + 1] + c * S[z + 2];
        T[3 * r + 1] = a * S[z + 1] + b * S[z + 3] + c * S[z + 4];
        T[3 * r + 2] = a * S[z + 2] + b * S[z + 4] + c * S[z + 5];
      }
      const product = (i, j) => T[3 * i] * M[3 * j] + T[3 * i + 1] * M[3 * j + 1] + T[3 * i + 2] * M[3 * j + 2];
      const xx = product(0, 0), yy = product(1, 1), zz = product(2, 2);
      const most = (MAX_STRETCH * t.scale) ** 2 * (S[z] + S[z + 3] + S[z + 5]);  // a torn body throws no spikes
      const shrink = Math.min(1, most / Math.max(xx + yy + zz, 1e-30));
      floats[s + 3] = xx * shrink;
      floats[F + s] = product(0, 1) * shrink; floats[F + s + 1] = product(0, 2) * shrink;
      floats[F + s + 2] = yy * shrink; floats[F + s + 3] = product(1, 2) * shrink;
      floats[2 * F + s] = zz * shrink;
      if (floats[2 * F + s + 1] < PLAIN) turn(M, 2 * F + s + 1);
    }
  }

  // Write x, y, z of the quaternion, of w >= 0, of the rotation next to M (Gram-Schmidt): it turns the harmonics.
  function turn(M, at) {
    let [a, d, g, b, e, h] = [M[0], M[3], M[6], M[1], M[4], M[7]];
    const n = Math.hypot(a, d, g) || 1;
    a /= n; d /= n; g /= n;
    const along = a * b + d * e + g * h;
    b -= along * a; e -= along * d; h -= along * g;
    const m = Math.hypot(b, e, h) || 1;
    b /= m; e /= m; h /= m;
    const c = d * h - g * e, f = g * b - a * h, i = a * e - d * b;
    floats[at] = Math.sign(h - f) * Math.sqrt(Math.max(0, 1 + a - e - i)) / 2;
    floats[at + 1] = Math.sign(c - g) * Math.sqrt(Math.max(0, 1 - a + e - i)) / 2;
    floats[at + 2] = Math.sign(d - b) * Math.sqrt(Math.max(0, 1 - a - e + i)) / 2;
  }

  // Let `shade` be what it is at a keyframe; returns whether it has changed.
  function shadeTo(k) {
    let changed = k < shadeAt;
    if (changed) {
      shade.fill(255);
      shadeAt = -1;
    }
    while (shadeAt < k && changes.length) {
      const [mask, values] = changes[++shadeAt];
      changed = changed || values.length > 0;
      for (let byte = 0, v = 0; v < values.length; byte++) {
        for (let bit = mask[byte], s = 8 * byte; bit; bit = bit << 1 & 255, s++) {
          if (bit & 128) shade[s] = values[v++];
        }
      }
    }
    return changed;
  }

  // Slots of what is there, farthest first: a counting sort of 16 bits of the distance from the eye.
  function sorted(live, eye) {
    let n = 0, nearest = Infinity, farthest = 0;
    for (const [begin, end] of live) {
      for (let s = begin; s < end; s++) {
        const x = floats[4 * s] - eye[0], y = floats[4 * s + 1] - eye[1], z = floats[4 * s + 2] - eye[2];
        const d = Math.sqrt(x * x + y * y + z * z);  // Math.hypot takes several times as long
        distances[n] = d;
        ids[n++] = s;
        if (d < nearest) nearest = d;
        if (d > farthest) farthest = d;
      }
    }
    const counts = new Uint32Array(65537), order = new Uint32Array(n), per = 65535 / Math.max(farthest - nearest, 1e-9);
    for (let i = 0; i < n; i++) counts[1 + ((farthest - distances[i]) * per | 0)]++;
    for (let i = 1; i < 65536; i++) counts[i] += counts[i - 1];
    for (let i = 0; i < n; i++) order[counts[(farthest - distances[i]) * per | 0]++] = ids[i];
    return order;
  }

  function moment(k, mix, eye) {
    const area = shade.length, live = play.still ? [[0, play.still]] : [];
    let low = Infinity, high = 0;
    for (const t of tracks) {
      if (k < t.first || k >= t.first + t.frames) continue;
      live.push([t.slot, t.slot + t.count]);
      if (!pose(t, k - t.first, mix)) continue;
      carry(t, area);
      low = Math.min(low, t.slot);
      high = Math.max(high, t.slot + t.count);
    }
    const begin = Math.floor(low / ROW), rows = Math.ceil(high / ROW) - begin;
    let moved = null;
    if (high) {
      moved = new Float32Array(12 * ROW * rows);
      for (let layer = 0; layer < 3; layer++) {
        const from = 4 * (layer * area + begin * ROW);
        moved.set(floats.subarray(from, from + 4 * ROW * rows), 4 * layer * ROW * rows);
      }
    }
    const there = `${live} ${eye}`, order = moved || there !== sortedFor ? sorted(live, eye) : null;
    sortedFor = there;
    const light = shadeTo(k) ? shade.slice() : null;
    postMessage({ order, moved, begin, rows, light }, [order, moved, light].filter(Boolean).map((array) => array.buffer));
  }

  onmessage = ({ data }) => data.scene ? open(data.scene, data.motion) : moment(data.k, data.mix, data.eye);
  onunhandledrejection = (event) => { throw event.reason; };  // tells the page
}

// ---------------------------------------------------------------- drawing

const VERTEX = `#version 300 es
precision highp float; precision highp int; precision highp sampler2D; precision highp sampler2DArray;
uniform sampler2DArray floats, colours;
uniform sampler2D light;
uniform mat3 camera;  // columns: right, down, forward
uniform vec3 eye;
uniform vec2 size;  // [px]
uniform float focal;  // [px]
uniform bool antialias;
uniform int coefficients;
in uint slot;
out vec2 place;  // [sigma]
out vec4 colour;

vec3 sh(ivec2 at, int k) { return (texelFetch(colours, ivec3(at, k), 0).rgb * 255.0 - 128.0) / 128.0; }

vec3 harmonics(ivec2 at, vec3 d) {
  float x = d.x, y = d.y, z = d.z, xx = x * x, yy = y * y, zz = z * z;
  vec3 c = 0.48860251 * (z * sh(at, 2) - y * sh(at, 1) - x * sh(at, 3));
  if (coefficients > 3) {
    c += 1.09254843 * (x * y * sh(at, 4) - y * z * sh(at, 5) - x * z * sh(at, 7));
    c += 0.31539157 * (2.0 * zz - xx - yy) * sh(at, 6) + 0.54627421 * (xx - yy) * sh(at, 8);
  }
  if (coefficients > 8) {
    c += 2.89061144 * x * y * z * sh(at, 10) + 1.44530572 * z * (xx - yy) * sh(at, 14);
    c -= 0.59004359 * (y * (3.0 * xx - yy) * sh(at, 9) + x * (xx - 3.0 * yy) * sh(at, 15));
    c -= 0.45704580 * (4.0 * zz - xx - yy) * (y * sh(at, 11) + x * sh(at, 13));
    c += 0.37317633 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * sh(at, 12);
  }
  return c;
}

void main() {
  ivec2 at = ivec2(int(slot) % ${ROW}, int(slot) / ${ROW});
  vec4 a = texelFetch(floats, ivec3(at, 0), 0), b = texelFetch(floats, ivec3(at, 1), 0);
  vec4 c = texelFetch(floats, ivec3(at, 2), 0), shown = texelFetch(colours, ivec3(at, 0), 0);
  vec3 p = (a.xyz - eye) * camera;
  gl_Position = vec4(0.0, 0.0, 2.0, 1.0);  // nothing
  if (p.z < 0.01 || shown.a < 1.0 / 255.0) return;
  // Sigma_2D = J W Sigma W^T J^T + 0.3 I, x/z and y/z held near the picture     render/projection.py
  vec2 held = clamp(p.xy / p.z, -0.65 * size / focal, 0.65 * size / focal);
  mat3 sigma = mat3(a.w, b.x, b.y, b.x, b.z, b.w, b.y, b.w, c.x);
  vec3 jx = focal / p.z * (camera[0] - held.x * camera[2]), jy = focal / p.z * (camera[1] - held.y * camera[2]);
  vec3 sx = sigma * jx;
  float xx = dot(jx, sx), xy = dot(jy, sx), yy = dot(jy, sigma * jy), sharp = xx * yy - xy * xy;
  xx += 0.3; yy += 0.3;
  float det = xx * yy - xy * xy, opacity = shown.a;
  if (antialias) opacity *= sqrt(max(0.0, sharp / det));
  float limit = 2.0 * log(255.0 * opacity);
  if (limit <= 0.0 || !(det > 0.0)) return;
  float middle = 0.5 * (xx + yy), spread = sqrt(max(0.25 * (xx - yy) * (xx - yy) + xy * xy, 0.0));
  float longest = middle + spread, shortest = max(middle - spread, 0.09);
  vec2 axis = abs(xy) > 1e-6 ? normalize(vec2(xy, longest - xx)) : xx >= yy ? vec2(1.0, 0.0) : vec2(0.0, 1.0);
  place = sqrt(limit) * (vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0);
  vec2 pixel = focal * p.xy / p.z + place.x * sqrt(longest) * axis + place.y * sqrt(shortest) * vec2(-axis.y, axis.x);
  gl_Position = vec4(pixel * vec2(2.0, -2.0) / size, 0.0, 1.0);
  vec3 rgb = 0.5 + 0.28209479 / 0.15 * (shown.rgb - 0.5);
  if (c.y < 1.5) {  // not PLAIN
    vec3 q = c.yzw, d = normalize(a.xyz - eye), t = 2.0 * cross(d, q);  // the inverse turn
    d += sqrt(max(0.0, 1.0 - dot(q, q))) * t + cross(t, q);
    rgb += harmonics(at, d * vec3(1.0, -1.0, -1.0));  // SPZ: y and z the other way
  }
  colour = vec4(max(rgb, 0.0) * texelFetch(light, at, 0).r, opacity);
}`;

const FRAGMENT = `#version 300 es
precision highp float;
in vec2 place;
in vec4 colour;
out vec4 drawn;
void main() {
  float alpha = colour.a * exp(-0.5 * dot(place, place));
  if (alpha < 1.0 / 255.0) discard;
  drawn = vec4(colour.rgb * alpha, alpha);
}`;

class Painter {
  constructor(gl, { play, area, layers, floats, colours }) {
    this.gl = gl;
    const program = this.program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.bindAttribLocation(program, 0, "slot");
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
      throw new Error([...gl.getAttachedShaders(program)].map((s) => gl.getShaderInfoLog(s)).join(" "));
    }
    gl.useProgram(program);
    this.rows = area / ROW;
    if (this.rows > gl.getParameter(gl.MAX_TEXTURE_SIZE)) throw new Error("This scene is too large for the graphics here.");
    const texture = (unit, kind) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(kind, gl.createTexture());
      gl.texParameteri(kind, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
      gl.texParameteri(kind, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    };
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    texture(0, gl.TEXTURE_2D_ARRAY);
    gl.texImage3D(gl.TEXTURE_2D_ARRAY, 0, gl.RGBA32F, ROW, this.rows, 3, 0, gl.RGBA, gl.FLOAT, floats);
    texture(1, gl.TEXTURE_2D_ARRAY);
    gl.texImage3D(gl.TEXTURE_2D_ARRAY, 0, gl.RGBA8, ROW, this.rows, layers, 0, gl.RGBA, gl.UNSIGNED_BYTE, colours);
    texture(2, gl.TEXTURE_2D);
    this.setLight(new Uint8Array(area).fill(255));
    ["floats", "colours", "light"].forEach((name, unit) => gl.uniform1i(this.at(name), unit));
    gl.uniform1i(this.at("antialias"), play.antialias);
    gl.uniform1i(this.at("coefficients"), layers - 1);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.enableVertexAttribArray(0);
    gl.vertexAttribIPointer(0, 1, gl.UNSIGNED_INT, 0, 0);
    gl.vertexAttribDivisor(0, 1);
    gl.enable(gl.BLEND); gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.clearColor(...play.background, 1);
  }

  at(name) { return this.gl.getUniformLocation(this.program, name); }

  setLight(light) {
    const gl = this.gl;
    gl.activeTexture(gl.TEXTURE2);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.R8, ROW, this.rows, 0, gl.RED, gl.UNSIGNED_BYTE, light);
  }

  take({ order, moved, begin, rows, light }) {
    const gl = this.gl;
    if (light) this.setLight(light);
    gl.activeTexture(gl.TEXTURE0);
    if (moved) gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, 0, 0, begin, 0, ROW, rows, 3, gl.RGBA, gl.FLOAT, moved);
    if (order) gl.bufferData(gl.ARRAY_BUFFER, order, gl.DYNAMIC_DRAW);
    if (order) this.count = order.length;
    return Boolean(order || light);
  }

  draw(view) {
    const gl = this.gl, { width, height } = picture;
    gl.viewport(0, 0, width, height);
    gl.uniformMatrix3fv(this.at("camera"), false, view.axes.flat());
    gl.uniform3fv(this.at("eye"), view.eye);
    gl.uniform2f(this.at("size"), width, height);
    gl.uniform1f(this.at("focal"), view.focal);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.count);
  }
}

// ---------------------------------------------------------------- the view

const sum = (a, b, factor = 1) => a.map((v, k) => v + factor * b[k]);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const clamp = (v, low, high) => Math.min(Math.max(v, low), high);

class Orbit {
  constructor(play) { this.play = play; this.reset(); }

  reset() {
    const away = sum(this.play.eye, this.play.target, -1);
    this.target = this.play.target;
    this.distance = this.first = Math.hypot(...away);
    this.yaw = Math.atan2(away[0], away[2]);
    this.pitch = Math.asin(clamp(away[1] / this.distance, -1, 1));
    this.lowest = this.play.still ? Math.min(LOWEST, this.pitch) : -STEEPEST;
  }

  turn(dx, dy) {
    this.yaw -= TURN_PER_PIXEL * dx;
    this.pitch = clamp(this.pitch + TURN_PER_PIXEL * dy, this.lowest, STEEPEST);
  }

  zoom(factor) { this.distance = clamp(this.distance * factor, NEAREST, FARTHEST * this.first); }

  move(dx, dy) {  // CSS pixels, at the target
    const { axes: [right, down], focal } = this.view(), metres = this.distance / focal * picture.width / innerWidth;
    this.target = sum(sum(this.target, right, -dx * metres), down, -dy * metres);
  }

  view() {
    const level = Math.cos(this.pitch);
    const back = [level * Math.sin(this.yaw), Math.sin(this.pitch), level * Math.cos(this.yaw)];
    const forward = back.map((v) => -v), right = [Math.cos(this.yaw), 0, -Math.sin(this.yaw)];
    const focal = 0.5 * Math.min(picture.height, picture.width / WIDEST) / Math.tan(0.5 * this.play.fov_y);
    return { eye: sum(this.target, back, this.distance), axes: [right, cross(forward, right), forward], focal };
  }
}

// ---------------------------------------------------------------- the page

let painter = null, orbit = null, times = [0], time = 0, playing = false;
let asked = "", busy = false, stale = true, last = 0;

const say = (text) => Object.assign(get("say"), { textContent: text, hidden: !text });

function fail(text) {
  painter = null;
  get("bar").hidden = get("hint").hidden = true;
  say(text);
}

const bytesOf = (id) => {
  const text = atob(get(id).textContent), bytes = new Uint8Array(text.length);
  for (let k = 0; k < text.length; k++) bytes[k] = text.charCodeAt(k);
  get(id).remove();
  return bytes;
};

function start() {
  const gl = picture.getContext("webgl2", { alpha: false, antialias: false, powerPreference: "high-performance" });
  if (!gl) return fail("This browser cannot show the scene: it has no WebGL 2. Try another browser or switch its hardware acceleration on.");
  if (!window.DecompressionStream) return fail("This browser is too old to unpack the scene. Please update it.");
  picture.addEventListener("webglcontextlost", () => fail("The graphics card was reset. Please reload the page."));
  const worker = new Worker(URL.createObjectURL(new Blob([`(${work})()`], { type: "text/javascript" })));
  worker.onerror = (event) => fail(`The scene cannot be shown: ${event.message}`);
  worker.onmessage = ({ data }) => {
    if (data.play) {
      try {
        painter = new Painter(gl, data);
      } catch (error) {
        return fail(error.message);
      }
      orbit = new Orbit(data.play);
      times = data.play.times;
      requestAnimationFrame((now) => tick(now, worker));
    } else if (painter) {
      busy = false;
      stale = painter.take(data) || stale;
      if (!get("say").hidden) begin();
    }
  };
  const scene = bytesOf("scene"), motion = bytesOf("motion");
  worker.postMessage({ scene, motion }, [scene.buffer, motion.buffer]);
}

function begin() {
  say("");
  get("bar").hidden = times.length < 2;
  get("hint").hidden = false;
  setTimeout(() => get("hint").classList.add("gone"), 1000 * HINT_SECONDS);
  setPlaying(times.length > 1);
}

function tick(now, worker) {
  if (!painter) return;
  requestAnimationFrame((next) => tick(next, worker));
  const end = times[times.length - 1], before = time;
  if (playing) time += Math.min((now - last) / 1000, 0.25);
  if (time > end + END_SECONDS) time = 0;
  last = now;
  if (time !== before) showTime();
  const width = Math.round(innerWidth * Math.min(devicePixelRatio, PIXELS_MAX));
  const height = Math.round(innerHeight * Math.min(devicePixelRatio, PIXELS_MAX));
  if (picture.width !== width || picture.height !== height) {
    Object.assign(picture, { width, height });
    stale = true;
  }
  const view = orbit.view(), at = Math.min(time, end);
  let k = 0;
  while (k + 1 < times.length && times[k + 1] <= at) k++;
  const mix = k + 1 < times.length ? (at - times[k]) / (times[k + 1] - times[k]) : 0;
  const request = `${k} ${mix} ${view.eye}`;
  if (!busy && request !== asked) {
    busy = true;
    asked = request;
    worker.postMessage({ k, mix, eye: view.eye });
  }
  const drawn = `${view.eye} ${view.axes}`;
  if (stale || drawn !== painter.drawn) {
    stale = false;
    painter.drawn = drawn;
    painter.draw(view);
  }
}

function showTime() {
  const end = times[times.length - 1], clock = (t) => `${Math.floor(t / 60)}:${String(Math.floor(t % 60)).padStart(2, "0")}`;
  slider.value = 1000 * Math.min(time / end, 1);
  get("clock").textContent = `${clock(Math.min(time, end))} / ${clock(end)}`;
}

function setPlaying(on) {
  playing = on;
  get("icon").setAttribute("d", on ? "M4 2h3.5v14H4zM10.5 2H14v14h-3.5z" : "M4 2l11 7-11 7z");
  showTime();
}

const fingers = new Map();  // by pointer: place and button

picture.onpointerdown = (event) => {
  picture.setPointerCapture(event.pointerId);
  fingers.set(event.pointerId, [event.clientX, event.clientY, event.button || event.shiftKey]);
  picture.classList.add("held");
};

picture.onpointermove = (event) => {
  const finger = fingers.get(event.pointerId);
  if (!finger || !orbit) return;
  const dx = event.clientX - finger[0], dy = event.clientY - finger[1];
  const other = [...fingers].find(([id]) => id !== event.pointerId);
  if (other) {
    const apart = (x, y) => Math.max(Math.hypot(x - other[1][0], y - other[1][1]), 1);
    orbit.zoom(apart(finger[0], finger[1]) / apart(event.clientX, event.clientY));
    orbit.move(dx / 2, dy / 2);
  } else if (finger[2]) {
    orbit.move(dx, dy);
  } else {
    orbit.turn(dx, dy);
  }
  fingers.set(event.pointerId, [event.clientX, event.clientY, finger[2]]);
};

picture.onpointerup = picture.onpointercancel = (event) => {
  fingers.delete(event.pointerId);
  picture.classList.toggle("held", fingers.size > 0);
};

picture.oncontextmenu = (event) => event.preventDefault();
picture.addEventListener("wheel", (event) => {
  event.preventDefault();
  if (orbit) orbit.zoom(Math.exp(ZOOM_PER_PIXEL * clamp(event.deltaY * (event.deltaMode ? 30 : 1), -300, 300)));
}, { passive: false });

get("play").onclick = () => setPlaying(!playing);
slider.oninput = () => {
  time = slider.value / 1000 * times[times.length - 1];
  setPlaying(false);
};
addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || !orbit) return;
  if (event.key === " " && event.target !== get("play")) {
    event.preventDefault();
    if (times.length > 1) setPlaying(!playing);
  } else if (event.key.toLowerCase() === "r") {
    orbit.reset();
  }
});

start();
