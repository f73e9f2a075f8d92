// A mesh that turns: drag to orbit, right button or shift to move, wheel to come closer.
// Positions are 16 bits over the bounding box, colours 8 bits; light comes from the camera.
(canvas => {
  const gl = canvas.getContext("webgl2", {antialias: true});
  if (!gl) { canvas.replaceWith("This browser has no WebGL 2: no 3D view."); return; }
  const data = canvas.dataset, size = data.size.split(",").map(Number);
  const bytes = s => Uint8Array.from(atob(s), c => c.charCodeAt(0)).buffer;
  const attribute = (place, array, type, normalized) => {
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, array, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, 3, type, normalized, 0, 0);
  };
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, `#version 300 es
    layout(location=0) in vec3 place; layout(location=1) in vec3 color;
    uniform mat4 view; uniform vec3 size; out vec3 shade, at;
    void main() { at = (place - 0.5) * size; shade = color; gl_Position = view * vec4(at, 1); }`],
    [gl.FRAGMENT_SHADER, `#version 300 es
    precision highp float; in vec3 shade, at; uniform vec3 eye; out vec4 seen;
    void main() {
      vec3 n = normalize(cross(dFdx(at), dFdy(at)));
      float facing = abs(dot(n, normalize(eye - at)));
      seen = vec4(shade * (0.45 + 0.55 * facing), 1);
    }`]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text); gl.compileShader(shader); gl.attachShader(program, shader);
  }
  gl.linkProgram(program); gl.useProgram(program);
  attribute(0, new Uint16Array(bytes(data.places)), gl.UNSIGNED_SHORT, true);
  attribute(1, new Uint8Array(bytes(data.colors)), gl.UNSIGNED_BYTE, true);
  const faces = new Uint32Array(bytes(data.faces));
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, faces, gl.STATIC_DRAW);
  gl.enable(gl.DEPTH_TEST); gl.enable(gl.CULL_FACE); gl.clearColor(1, 1, 1, 1);
  const uniform = name => gl.getUniformLocation(program, name);
  gl.uniform3fv(uniform("size"), size);
  const reach = Math.hypot(...size);
  let turn = -2, lift = 0.9, away = 0.95 * reach, center = [0, 0, 0];
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const axes = () => {  // right, up, and back towards the eye
    const [c, s, cl, sl] = [Math.cos(turn), Math.sin(turn), Math.cos(lift), Math.sin(lift)];
    return [[-s, c, 0], [-c * sl, -s * sl, cl], [c * cl, s * cl, sl]];
  };
  const draw = () => {
    const [w, h] = [canvas.clientWidth, canvas.clientHeight].map(x => x * devicePixelRatio);
    canvas.width = w; canvas.height = h; gl.viewport(0, 0, w, h);
    const [r, u, b] = axes(), eye = center.map((c, i) => c + away * b[i]);
    const f = 1.7, near = reach / 100, far = 10 * reach, z = (far + near) / (near - far);
    const k = 2 * far * near / (near - far), fx = f * h / w, d = [r, u, b].map(a => -dot(a, eye));
    gl.uniformMatrix4fv(uniform("view"), false, [
      fx * r[0], f * u[0], z * b[0], -b[0], fx * r[1], f * u[1], z * b[1], -b[1],
      fx * r[2], f * u[2], z * b[2], -b[2], fx * d[0], f * d[1], z * d[2] + k, -d[2]]);
    gl.uniform3fv(uniform("eye"), eye);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.drawElements(gl.TRIANGLES, faces.length, gl.UNSIGNED_INT, 0);
  };
  canvas.onpointerdown = e => canvas.setPointerCapture(e.pointerId);
  canvas.oncontextmenu = e => e.preventDefault();
  canvas.onpointermove = e => {
    if (!e.buttons) return;
    if (e.buttons & 2 || e.shiftKey) {
      const [r, u] = axes(), s = away / canvas.clientHeight;
      center = center.map((c, i) => c + s * (e.movementY * u[i] - e.movementX * r[i]));
    } else {
      turn -= e.movementX / 150;
      lift = Math.min(1.57, Math.max(-1.57, lift + e.movementY / 150));
    }
    requestAnimationFrame(draw);
  };
  canvas.addEventListener("wheel", e => {
    e.preventDefault(); away *= Math.exp(e.deltaY / 800); requestAnimationFrame(draw);
  }, {passive: false});
  addEventListener("resize", draw); draw();
})(document.currentScript.previousElementSibling);
