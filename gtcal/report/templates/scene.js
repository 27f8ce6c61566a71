// The 3-D view: draws the lines of every <canvas data-scene="id"> and lets the reader turn them by mouse, touch or keys.
"use strict";

(() => {
  const START = { turn: 1.0, tilt: 0.4, zoom: 1 };
  const STEP = Math.PI / 24;
  const MOST_TILT = Math.PI / 2 - 0.01;
  const EYE_DISTANCE = 4; // in radii of the scene: a mild perspective

  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const combine = (s, a, t, b) => [s * a[0] + t * b[0], s * a[1] + t * b[1], s * a[2] + t * b[2]];
  const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

  // Centre and radius of a ball around all points.
  function bounds(lines) {
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    for (const line of lines) for (const point of line.points) for (let i = 0; i < 3; i++) {
      low[i] = Math.min(low[i], point[i]);
      high[i] = Math.max(high[i], point[i]);
    }
    const centre = low.map((value, i) => (value + high[i]) / 2);
    let radius = 1e-6;
    for (const line of lines) for (const point of line.points) {
      radius = Math.max(radius, Math.hypot(point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]));
    }
    return { centre, radius };
  }

  // Right, up and towards the eye, as unit vectors in ref.
  function viewAxes(scene, view) {
    const side = cross(scene.up, scene.back);
    const level = combine(Math.cos(view.turn), scene.back, Math.sin(view.turn), side);
    const toEye = combine(Math.cos(view.tilt), level, Math.sin(view.tilt), scene.up);
    const right = cross(scene.up, level);
    return { right, up: cross(toEye, right), toEye };
  }

  function projector(scene, ball, view, scale, width, height) {
    const axes = viewAxes(scene, view);
    return (point) => {
      const offset = combine(1, point, -1, ball.centre);
      const nearness = dot(offset, axes.toEye) / ball.radius; // -1 far .. 1 near
      const perspective = EYE_DISTANCE / Math.max(EYE_DISTANCE - nearness, 0.5);
      return [
        width / 2 + dot(offset, axes.right) * scale * perspective,
        height / 2 - dot(offset, axes.up) * scale * perspective,
        nearness,
      ];
    };
  }

  // Pixels per metre at which everything is in sight from where one first looks.
  function fittingScale(scene, ball, width, height) {
    const project = projector(scene, ball, START, 1, 0, 0);
    let across = 1e-9, down = 1e-9;
    for (const line of scene.lines) for (const point of line.points) {
      const [x, y] = project(point);
      across = Math.max(across, Math.abs(x));
      down = Math.max(down, Math.abs(y));
    }
    return Math.min(width / across, height / down) * 0.46;
  }

  const depth = (points) => points.reduce((sum, point) => sum + point[2], 0) / points.length;

  function drawLine(context, line, points, scale) {
    const fog = clamp(0.72 + 0.28 * depth(points), 0.35, 1); // what is far is paler
    context.globalAlpha = line.opacity * fog;
    context.strokeStyle = context.fillStyle = line.colour;
    context.lineWidth = line.width * scale;
    context.beginPath();
    if (points.length === 1) {
      context.arc(points[0][0], points[0][1], line.width * scale * 0.6, 0, 2 * Math.PI);
      context.fill();
      return;
    }
    points.forEach(([x, y], index) => (index ? context.lineTo(x, y) : context.moveTo(x, y)));
    if (line.fill > 0) {
      context.closePath();
      context.globalAlpha = line.fill * fog;
      context.fill();
      context.globalAlpha = line.opacity * fog;
    }
    context.stroke();
  }

  function drawLabel(context, line, [x, y], scale) {
    context.globalAlpha = 1;
    context.font = `600 ${12 * scale}px system-ui, sans-serif`;
    context.lineWidth = 3.5 * scale;
    context.strokeStyle = "#ffffff";
    context.strokeText(line.label, x + 6 * scale, y - 5 * scale);
    context.fillStyle = line.colour;
    context.fillText(line.label, x + 6 * scale, y - 5 * scale);
  }

  function start(canvas) {
    const scene = JSON.parse(document.getElementById(canvas.dataset.scene).textContent);
    const ball = bounds(scene.lines);
    const view = { ...START };
    const hidden = new Set();
    const context = canvas.getContext("2d");

    function draw() {
      const scale = Math.max(window.devicePixelRatio || 1, 2); // sharp in print, too
      const width = canvas.clientWidth * scale, height = canvas.clientHeight * scale;
      if (!width || !height) return;
      if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
      context.lineJoin = context.lineCap = "round";
      context.clearRect(0, 0, width, height);
      const pixelsPerMetre = fittingScale(scene, ball, width, height) * view.zoom;
      const project = projector(scene, ball, view, pixelsPerMetre, width, height);
      const shown = scene.lines
        .filter((line) => !hidden.has(line.layer))
        .map((line) => ({ line, points: line.points.map(project) }))
        .sort((a, b) => depth(a.points) - depth(b.points));
      for (const { line, points } of shown) drawLine(context, line, points, scale);
      for (const { line, points } of shown) if (line.label) drawLabel(context, line, points[0], scale);
    }
    function turn(by, tiltBy) {
      view.turn += by;
      view.tilt = clamp(view.tilt + tiltBy, -MOST_TILT, MOST_TILT);
      draw();
    }
    function zoom(factor) {
      view.zoom = clamp(view.zoom * factor, 0.4, 12);
      draw();
    }
    function reset() {
      Object.assign(view, START);
      draw();
    }

    listenToPointers(canvas, turn, zoom);
    canvas.addEventListener("dblclick", reset);
    canvas.addEventListener("keydown", (event) => {
      const actions = {
        ArrowLeft: () => turn(-STEP, 0),
        ArrowRight: () => turn(STEP, 0),
        ArrowUp: () => turn(0, STEP),
        ArrowDown: () => turn(0, -STEP),
        "+": () => zoom(1.2),
        "=": () => zoom(1.2),
        "-": () => zoom(1 / 1.2),
        0: reset,
      };
      if (!(event.key in actions) || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      actions[event.key]();
    });
    for (const box of document.querySelectorAll(`input[data-layer-of="${canvas.dataset.scene}"]`)) {
      box.addEventListener("change", () => {
        if (box.checked) hidden.delete(box.value);
        else hidden.add(box.value);
        draw();
      });
    }
    for (const button of document.querySelectorAll(`button[data-zoom-of="${canvas.dataset.scene}"]`)) {
      button.addEventListener("click", () => (button.value === "reset" ? reset() : zoom(Number(button.value))));
    }
    new ResizeObserver(draw).observe(canvas); // also draws the first time
  }

  // One pointer turns; two pinch. The wheel zooms only where the view has the focus, else it scrolls the page.
  function listenToPointers(canvas, turn, zoom) {
    const pointers = new Map();
    const spread = () => {
      const [a, b] = [...pointers.values()];
      return Math.hypot(a.x - b.x, a.y - b.y);
    };
    canvas.addEventListener("pointerdown", (event) => {
      pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
      if (event.isTrusted) canvas.setPointerCapture(event.pointerId);
      canvas.focus({ preventScroll: true });
    });
    canvas.addEventListener("pointermove", (event) => {
      const last = pointers.get(event.pointerId);
      if (!last) return;
      const before = pointers.size === 2 ? spread() : 0;
      const [dx, dy] = [event.clientX - last.x, event.clientY - last.y];
      pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
      if (pointers.size === 1) turn(-dx * 0.008, dy * 0.008);
      else if (before > 0) zoom(spread() / before);
    });
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
      canvas.addEventListener(end, (event) => pointers.delete(event.pointerId));
    }
    canvas.addEventListener(
      "wheel",
      (event) => {
        if (document.activeElement !== canvas) return;
        event.preventDefault();
        zoom(Math.exp(-0.0012 * event.deltaY));
      },
      { passive: false },
    );
  }

  document.querySelectorAll("canvas[data-scene]").forEach(start);
})();
