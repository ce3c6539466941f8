"use strict";
// One mesh, coloured by one of several fields; drag, wheel or keys turn and zoom it. No library, no network.
(async () => {
  const canvas = document.getElementById("view"), choice = document.getElementById("colouring");
  const legend = document.getElementById("legend"), said = document.getElementById("view-state");
  const about = JSON.parse(document.getElementById("mesh-about").textContent);
  const gl = canvas.getContext("webgl2", { preserveDrawingBuffer: true, antialias: true });
  if (!gl) { said.textContent = "This browser shows no WebGL 2, which the 3-D view needs."; return; }

  const packed = Uint8Array.from(atob(document.getElementById("mesh-data").textContent), c => c.charCodeAt(0));
  const inflated = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(inflated).arrayBuffer());
  const n = about.vertices, m = 3 * about.triangles;
  // Positions: three planes of uint16, low bytes first. Corners: differences, zigzag, in four planes of bytes.
  const positions = new Uint16Array(3 * n), corners = new Uint32Array(m);
  for (let i = 0; i < 3 * n; ++i) positions[i] = bytes[i] | bytes[3 * n + i] << 8;
  let at = 6 * n, last = 0;
  for (let i = 0; i < m; ++i) {
    const z = (bytes[at + i] | bytes[at + m + i] << 8 | bytes[at + 2 * m + i] << 16 | bytes[at + 3 * m + i] << 24) >>> 0;
    last += (z >>> 1) ^ -(z & 1);
    corners[i] = last;
  }
  at += 4 * m;
  const fields = about.fields.map((f, k) => bytes.subarray(at + k * n, at + (k + 1) * n));

  const shader = (kind, text) => {
    const s = gl.createShader(kind);
    gl.shaderSource(s, text); gl.compileShader(s);
    if (!gl.getShaderParameter(s, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(s));
    return s;
  };
  const program = gl.createProgram();
  gl.attachShader(program, shader(gl.VERTEX_SHADER, `#version 300 es
    in vec3 at; in float value; uniform mat4 turn; uniform vec3 scale, middle; out float v; out vec3 p;
    void main() { p = (turn * vec4(at * scale - middle, 1.0)).xyz; v = value;
      gl_Position = vec4(p.xy, -0.2 * p.z, 1.0); }`));
  gl.attachShader(program, shader(gl.FRAGMENT_SHADER, `#version 300 es
    precision highp float; precision highp sampler2D; in float v; in vec3 p; out vec4 colour;
    uniform sampler2D palette; uniform vec2 aspect; uniform bool classes;
    void main() { vec3 q = vec3(p.xy / aspect, p.z); vec3 n = normalize(cross(dFdx(q), dFdy(q)));
      float k = classes ? floor(v + 0.5) : v; vec3 c = texture(palette, vec2((k + 0.5) / 256.0, 0.5)).rgb;
      colour = vec4(c * (0.45 + 0.55 * abs(n.z)), 1.0); }`));
  gl.linkProgram(program); gl.useProgram(program);
  const place = name => gl.getUniformLocation(program, name);
  const buffer = (target, data) => { gl.bindBuffer(target, gl.createBuffer()); gl.bufferData(target, data, gl.STATIC_DRAW); };
  // Three planes to triples.
  const triples = new Uint16Array(3 * n);
  for (let i = 0; i < n; ++i) for (let k = 0; k < 3; ++k) triples[3 * i + k] = positions[k * n + i];
  buffer(gl.ARRAY_BUFFER, triples);
  const atPlace = gl.getAttribLocation(program, "at"), valuePlace = gl.getAttribLocation(program, "value");
  gl.enableVertexAttribArray(atPlace); gl.vertexAttribPointer(atPlace, 3, gl.UNSIGNED_SHORT, true, 0, 0);
  const values = gl.createBuffer();
  gl.enableVertexAttribArray(valuePlace);
  buffer(gl.ELEMENT_ARRAY_BUFFER, corners);
  gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
  for (const [name, value] of [[gl.TEXTURE_MIN_FILTER, gl.NEAREST], [gl.TEXTURE_MAG_FILTER, gl.NEAREST],
    [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE]]) gl.texParameteri(gl.TEXTURE_2D, name, value);
  gl.enable(gl.DEPTH_TEST); gl.clearColor(1, 1, 1, 1);
  const [sx, sy, sz] = about.size_mm, half = Math.hypot(sx, sy, sz) / 2;
  gl.uniform3f(place("scale"), sx / half, sy / half, sz / half);
  gl.uniform3f(place("middle"), sx / half / 2, sy / half / 2, sz / half / 2);

  const start = { yaw: 0.0, pitch: -0.6, zoom: 1.0 };
  const eye = { ...start };
  const draw = () => {
    const ratio = devicePixelRatio || 1, w = Math.round(canvas.clientWidth * ratio), h = Math.round(canvas.clientHeight * ratio);
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
    const s = eye.zoom * 0.98, ax = s * Math.min(1, h / w), ay = s * Math.min(1, w / h);
    const [cy, sy_, cp, sp] = [Math.cos(eye.yaw), Math.sin(eye.yaw), Math.cos(eye.pitch), Math.sin(eye.pitch)];
    gl.viewport(0, 0, w, h);
    gl.uniform2f(place("aspect"), ax, ay);
    gl.uniformMatrix4fv(place("turn"), false, [cy * ax, sy_ * cp * ay, sy_ * sp, 0, -sy_ * ax, cy * cp * ay, cy * sp, 0,
      0, -sp * ay, cp, 0, 0, 0, 0, 1]);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.drawElements(gl.TRIANGLES, m, gl.UNSIGNED_INT, 0);
  };
  const paint = () => {
    const field = about.fields[choice.selectedIndex];
    gl.bindBuffer(gl.ARRAY_BUFFER, values);
    gl.bufferData(gl.ARRAY_BUFFER, fields[choice.selectedIndex], gl.STATIC_DRAW);
    gl.vertexAttribPointer(valuePlace, 1, gl.UNSIGNED_BYTE, false, 0, 0);
    const pixels = new Uint8Array(1024);
    for (let i = 0; i < 256; ++i) {
      const stops = field.colours, x = field.classes ? Math.min(i, stops.length - 1) : i / 255 * (stops.length - 1);
      const k = Math.min(Math.floor(x), stops.length - 2 < 0 ? 0 : stops.length - 2), t = field.classes ? 0 : x - k;
      for (let c = 0; c < 3; ++c) {
        const a = stops[field.classes ? x : k][c], b = stops[Math.min(k + 1, stops.length - 1)][c];
        pixels[4 * i + c] = a + (field.classes ? 0 : (b - a) * t);
      }
      pixels[4 * i + 3] = 255;
    }
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 256, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    gl.uniform1i(place("classes"), field.classes ? 1 : 0);
    const css = c => `rgb(${c.join(",")})`;
    legend.replaceChildren();
    if (field.classes) field.names.forEach((name, i) => {
      const item = document.createElement("span"), chip = document.createElement("span");
      chip.className = "chip"; chip.style.background = css(field.colours[i]);
      item.append(chip, name); legend.append(item);
    });
    else {
      const ramp = document.createElement("span");
      ramp.className = "ramp"; ramp.style.background = `linear-gradient(90deg, ${field.colours.map(css).join(", ")})`;
      legend.append("0", ramp, field.most);
    }
    draw();
  };
  choice.addEventListener("change", paint);
  const turn = (dx, dy) => { eye.yaw += dx; eye.pitch = Math.max(-3.1, Math.min(0.0, eye.pitch + dy)); draw(); };
  const zoom = f => { eye.zoom = Math.max(0.3, Math.min(30, eye.zoom * f)); draw(); };
  canvas.addEventListener("pointerdown", e => canvas.setPointerCapture(e.pointerId));
  canvas.addEventListener("pointermove", e => { if (e.buttons) turn(e.movementX * 0.008, e.movementY * 0.008); });
  canvas.addEventListener("wheel", e => { e.preventDefault(); zoom(Math.exp(-e.deltaY * 0.001)); }, { passive: false });
  canvas.addEventListener("keydown", e => {
    const steps = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] };
    if (steps[e.key]) { turn(...steps[e.key]); e.preventDefault(); }
    else if (e.key === "+") zoom(1.2); else if (e.key === "-") zoom(1 / 1.2);
  });
  document.getElementById("reset").addEventListener("click", () => { Object.assign(eye, start); draw(); });
  addEventListener("resize", draw);
  paint();
  said.textContent = "Drag to turn, wheel to zoom; with the view focused, arrow keys and + and -.";
})().catch(error => { document.getElementById("view-state").textContent = "The 3-D view failed: " + error.message; });
