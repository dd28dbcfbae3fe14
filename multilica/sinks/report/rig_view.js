// SPDX-License-Identifier: Apache-2.0
// Draws the clouds of the page's scene with WebGL: orbit, pan and zoom by mouse, touch and keyboard.
"use strict";
(() => {
  const figure = document.getElementById("rig-view");
  const scene = JSON.parse(document.getElementById("rig-scene").textContent);
  const canvas = figure.querySelector("canvas");
  const context = { antialias: true, preserveDrawingBuffer: true }; // the buffer is kept for printing
  const gl = canvas.getContext("webgl", context);
  if (!gl) {
    figure.dataset.state = "unavailable";
    return;
  }

  const GROUND = [15 / 255, 19 / 255, 25 / 255];
  const FIELD_OF_VIEW = 0.8;
  const AXIS_COLOURS = [[1, 0.47, 0.43], [0.47, 0.86, 0.51], [0.47, 0.67, 1]];
  const GRID_HALF_SIZE_M = 30, GRID_SPACING_M = 5, AXIS_LENGTH_M = 0.8, LABEL_HEIGHT_PX = 16;
  const HOME = { yaw: scene.direction[0], pitch: scene.direction[1], distance: scene.distance, centre: scene.centre };
  const VIEWS = {
    home: HOME,
    top: { ...HOME, yaw: -Math.PI / 2, pitch: Math.PI / 2 },
    side: { ...HOME, yaw: -Math.PI / 2, pitch: 0.03 },
  };

  const VERTEX = `
    attribute vec3 position;
    uniform mat4 view, model;
    uniform vec3 low, span;
    uniform float size, fade;
    varying float nearness;
    void main() {
      gl_Position = view * model * vec4(low + span * position, 1.0);
      gl_PointSize = size;
      nearness = clamp(1.25 - gl_Position.w / fade, 0.4, 1.0);
    }`;
  const FRAGMENT = `
    precision mediump float;
    uniform vec3 colour;
    varying float nearness;
    void main() { gl_FragColor = vec4(colour * nearness, 1.0); }`;

  let camera = { ...HOME };
  let recorded = false; // every cloud in its own frame, as it was before the calibration
  let drawn = false;
  let program, lines;

  function compile(type, source) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    return shader;
  }

  function buffer(data) {
    const made = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, made);
    gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
    return made;
  }

  function setUp() {
    program = gl.createProgram();
    gl.attachShader(program, compile(gl.VERTEX_SHADER, VERTEX));
    gl.attachShader(program, compile(gl.FRAGMENT_SHADER, FRAGMENT));
    gl.bindAttribLocation(program, 0, "position");
    gl.linkProgram(program);
    gl.useProgram(program);
    gl.enableVertexAttribArray(0);
    gl.enable(gl.DEPTH_TEST);
    for (const cloud of scene.clouds) {
      const bytes = Uint8Array.from(atob(cloud.points), (character) => character.charCodeAt(0));
      cloud.buffer = buffer(bytes);
    }
    lines = { grid: buffer(gridLines()), axes: AXIS_COLOURS.map((_, axis) => buffer(axisLine(axis))) };
  }

  function gridLines() {
    const ends = [];
    for (let at = -GRID_HALF_SIZE_M; at <= GRID_HALF_SIZE_M; at += GRID_SPACING_M) {
      ends.push(at, -GRID_HALF_SIZE_M, 0, at, GRID_HALF_SIZE_M, 0);
      ends.push(-GRID_HALF_SIZE_M, at, 0, GRID_HALF_SIZE_M, at, 0);
    }
    return new Float32Array(ends);
  }

  function axisLine(axis) {
    const line = new Float32Array(6);
    line[3 + axis] = AXIS_LENGTH_M;
    return line;
  }

  // Matrices are column by column, as WebGL takes them.
  function multiply(a, b) {
    const product = new Array(16).fill(0);
    for (let column = 0; column < 4; column++)
      for (let row = 0; row < 4; row++)
        for (let inner = 0; inner < 4; inner++)
          product[4 * column + row] += a[4 * inner + row] * b[4 * column + inner];
    return product;
  }

  const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

  // Unit vectors of the picture in the scene: to the right, upwards, and towards the eye.
  function directions() {
    const [sy, cy, sp, cp] = [Math.sin(camera.yaw), Math.cos(camera.yaw), Math.sin(camera.pitch), Math.cos(camera.pitch)];
    return { right: [-sy, cy, 0], up: [-cy * sp, -sy * sp, cp], back: [cy * cp, sy * cp, sp] };
  }

  function viewMatrix() {
    const { right, up, back } = directions();
    const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    const { centre, distance } = camera;
    const look = [
      right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0,
      -dot(right, centre), -dot(up, centre), -dot(back, centre) - distance, 1,
    ];
    const [near, far] = [distance / 100, distance * 20];
    const scale = 1 / Math.tan(FIELD_OF_VIEW / 2);
    const projection = [
      scale * canvas.height / canvas.width, 0, 0, 0, 0, scale, 0, 0,
      0, 0, (far + near) / (near - far), -1, 0, 0, (2 * far * near) / (near - far), 0,
    ];
    return multiply(projection, look);
  }

  function set(name, value) {
    const place = gl.getUniformLocation(program, name);
    if (typeof value === "number") gl.uniform1f(place, value);
    else if (value.length === 3) gl.uniform3fv(place, value);
    else gl.uniformMatrix4fv(place, false, value);
  }

  function drawLines(data, count, model, colour) {
    gl.bindBuffer(gl.ARRAY_BUFFER, data);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    set("low", [0, 0, 0]);
    set("span", [1, 1, 1]);
    set("model", model);
    set("colour", colour);
    gl.drawArrays(gl.LINES, 0, count);
  }

  function drawCloud(cloud, model) {
    gl.bindBuffer(gl.ARRAY_BUFFER, cloud.buffer);
    gl.vertexAttribPointer(0, 3, gl.UNSIGNED_SHORT, true, 0, 0);
    set("low", cloud.low);
    set("span", cloud.span);
    set("model", model);
    set("colour", cloud.colour);
    gl.drawArrays(gl.POINTS, 0, cloud.count);
  }

  function modelOf(cloud) {
    return recorded ? scene.level : cloud.pose;
  }

  function draw() {
    drawn = false;
    const ratio = window.devicePixelRatio || 1;
    canvas.width = Math.round(canvas.clientWidth * ratio);
    canvas.height = Math.round(canvas.clientHeight * ratio);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(...GROUND, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const view = viewMatrix();
    set("view", view);
    set("size", Math.max(1.5, 1.5 * ratio));
    set("fade", 3 * camera.distance);
    drawLines(lines.grid, 4 * (2 * GRID_HALF_SIZE_M / GRID_SPACING_M + 1), IDENTITY, [0.16, 0.19, 0.23]);
    for (const cloud of scene.clouds) {
      const model = modelOf(cloud);
      cloud.shown = cloud.toggle.checked && model !== null;
      if (!cloud.shown) continue;
      drawCloud(cloud, model);
      lines.axes.forEach((axis, index) => drawLines(axis, 2, model, AXIS_COLOURS[index]));
    }
    placeLabels(view);
  }

  // Beside the sensors, one below the other where they would cover each other.
  function placeLabels(view) {
    const shown = [];
    for (const cloud of scene.clouds) {
      const origin = cloud.shown ? multiply(view, modelOf(cloud)).slice(12) : [0, 0, 0, 0];
      cloud.label.hidden = origin[3] <= 0;
      if (cloud.label.hidden) continue;
      const [x, y] = [origin[0] / origin[3], -origin[1] / origin[3]];
      shown.push({ label: cloud.label, left: (x + 1) / 2 * canvas.clientWidth, top: (y + 1) / 2 * canvas.clientHeight });
    }
    shown.sort((a, b) => a.top - b.top);
    shown.forEach((one, index) => {
      if (index > 0) one.top = Math.max(one.top, shown[index - 1].top + LABEL_HEIGHT_PX);
      one.label.style.transform = `translate(${(one.left + 10).toFixed(1)}px, ${one.top.toFixed(1)}px) translateY(-50%)`;
    });
  }

  function redraw() {
    if (drawn) return;
    drawn = true;
    requestAnimationFrame(draw);
  }

  function orbit(right, down) {
    camera.yaw -= right;
    camera.pitch = Math.min(Math.PI / 2, Math.max(-Math.PI / 2, camera.pitch + down));
    redraw();
  }

  function pan(right, down) {
    const along = directions();
    const scale = camera.distance * FIELD_OF_VIEW;
    camera.centre = camera.centre.map((value, axis) => value + scale * (down * along.up[axis] - right * along.right[axis]));
    redraw();
  }

  function zoom(factor) {
    camera.distance = Math.min(400, Math.max(1, camera.distance * factor));
    redraw();
  }

  function show(name) {
    camera = { ...VIEWS[name] };
    redraw();
  }

  function listenToPointers() {
    const held = new Map();
    const spread = () => {
      const [a, b] = [...held.values()];
      return Math.hypot(a.x - b.x, a.y - b.y);
    };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      canvas.focus({ preventScroll: true });
      held.set(event.pointerId, { x: event.clientX, y: event.clientY });
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = held.get(event.pointerId);
      if (!before) return;
      const wide = held.size === 2 ? spread() : 0;
      held.set(event.pointerId, { x: event.clientX, y: event.clientY });
      const [right, down] = [(event.clientX - before.x) / canvas.clientHeight, (event.clientY - before.y) / canvas.clientHeight];
      if (held.size === 2) {
        pan(right / 2, down / 2);
        if (wide > 0) zoom(wide / Math.max(1, spread()));
      } else if (event.shiftKey || event.buttons === 2) pan(right, down);
      else orbit(3 * right, 3 * down);
    });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => held.delete(event.pointerId));
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => {
      if (document.activeElement !== canvas && !event.ctrlKey) return; // else the page could not be scrolled past
      event.preventDefault();
      zoom(Math.exp(event.deltaY / 500));
    }, { passive: false });
  }

  function listenToKeys() {
    const arrows = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] };
    const others = { "+": () => zoom(0.85), "=": () => zoom(0.85), "-": () => zoom(1 / 0.85), Home: () => show("home") };
    canvas.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      if (event.key in arrows) (event.shiftKey ? pan : orbit)(...arrows[event.key]);
      else if (event.key in others) others[event.key]();
      else return;
      event.preventDefault();
    });
  }

  function listenToControls() {
    scene.clouds.forEach((cloud, index) => {
      cloud.toggle = figure.querySelector(`[data-cloud="${index}"]`);
      cloud.label = figure.querySelector(`[data-label="${index}"]`);
      cloud.toggle.addEventListener("change", redraw);
    });
    figure.querySelectorAll("[data-view]").forEach((button) => button.addEventListener("click", () => show(button.dataset.view)));
    const choice = figure.querySelector("[name=poses][value=recorded]");
    const choose = () => { recorded = choice.checked; redraw(); };
    figure.querySelectorAll("[name=poses]").forEach((option) => option.addEventListener("change", choose));
    choose();
  }

  setUp();
  listenToControls();
  listenToPointers();
  listenToKeys();
  canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
  canvas.addEventListener("webglcontextrestored", () => { setUp(); redraw(); });
  new ResizeObserver(redraw).observe(canvas);
  window.addEventListener("beforeprint", draw);
  figure.dataset.state = "ready";
})();
