"use strict";
// Draws the clouds of a report by WebGL. Coordinates: x right, y up, z towards the eye; mm.
(() => {
  const VERTEX = `
    attribute vec3 position, normal;
    attribute float value;
    uniform vec3 low, size, centre;
    uniform mat3 rotation;
    uniform vec2 pan, scale;
    uniform float distance, near, far, spacing, lit;
    varying float share, brightness;
    void main() {
      vec3 point = rotation * ((low + position * size - centre) * vec3(1.0, -1.0, -1.0));
      float depth = distance - point.z;
      gl_Position = vec4(scale * (point.xy + pan), (far + near) / (far - near) * depth - 2.0 * far * near / (far - near), depth);
      gl_PointSize = clamp(spacing / depth, 1.5, 48.0);
      vec3 turned = rotation * (normal * vec3(1.0, -1.0, -1.0));
      brightness = mix(1.0, 0.45 + 0.55 * abs(dot(turned, vec3(-0.35, 0.5, 0.79))), lit * step(0.1, length(normal)));
      share = value;
    }`;
  const FRAGMENT = `
    precision mediump float;
    varying float share, brightness;
    uniform sampler2D colours;
    uniform float grey;
    void main() {
      vec3 colour = share > 0.0 ? texture2D(colours, vec2((255.0 * share + 0.5) / 256.0, 0.5)).rgb : vec3(grey);
      gl_FragColor = vec4(colour * brightness, 1.0);
    }`;

  const bytes = text => Uint8Array.from(atob(text), letter => letter.charCodeAt(0));

  function program(gl) {
    const made = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(made, shader);
    }
    gl.linkProgram(made);
    return gl.getProgramParameter(made, gl.LINK_STATUS) ? made : null;
  }

  function element(kind, parent, properties = {}) {
    const made = Object.assign(document.createElement(kind), properties);
    parent.append(made);
    return made;
  }

  // Values at which a scale is labelled: multiples of 1, 2 or 5 times a power of ten.
  function ticks(low, high) {
    const rough = (high - low) / 4, power = 10 ** Math.floor(Math.log10(rough));
    const step = power * [1, 2, 5, 10].find(factor => factor * power >= rough);
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    const found = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push((k * step || 0).toFixed(digits));
    return found;
  }

  class View {
    constructor(figure) {
      this.about = JSON.parse(figure.querySelector(".described").textContent);
      this.stage = document.createElement("div");
      this.stage.className = "stage";
      this.canvas = element("canvas", this.stage, {tabIndex: 0});
      this.gl = this.canvas.getContext("webgl", {preserveDrawingBuffer: true});
      if (!this.gl || !(this.program = program(this.gl))) return; // the still picture stays
      const still = figure.querySelector(".still");
      this.canvas.setAttribute("role", "img");
      this.canvas.setAttribute("aria-label", still.alt + ". Interactive: arrow keys turn it, + and - zoom.");
      still.after(this.stage);
      this.tools = element("div", this.stage, {className: "tools"});
      this.load(bytes(figure.querySelector(".packed").textContent));
      this.addTools();
      this.reset();
      this.choose(0);
      this.listen();
      figure.classList.add("live");
      figure.querySelector(".hint").hidden = false;
      new ResizeObserver(() => this.draw()).observe(this.canvas);
      matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
    }

    load(packed) {
      const {gl, about} = this, n = about.points;
      const buffer = (from, length) => {
        const made = gl.createBuffer();
        gl.bindBuffer(gl.ARRAY_BUFFER, made);
        gl.bufferData(gl.ARRAY_BUFFER, packed.subarray(from, from + length), gl.STATIC_DRAW);
        return made;
      };
      gl.useProgram(this.program);
      this.place = name => gl.getUniformLocation(this.program, name);
      const attribute = name => gl.getAttribLocation(this.program, name);
      this.bind = (name, made, length, kind) => {
        gl.bindBuffer(gl.ARRAY_BUFFER, made);
        gl.enableVertexAttribArray(attribute(name));
        gl.vertexAttribPointer(attribute(name), length, kind, true, 0, 0);
      };
      this.bind("position", buffer(0, 6 * n), 3, gl.UNSIGNED_SHORT);
      this.values = about.quantities.map((_, k) => buffer((6 + 2 * k) * n, 2 * n));
      if (about.normals) this.bind("normal", buffer((6 + 2 * about.quantities.length) * n, 3 * n), 3, gl.BYTE);
      else gl.vertexAttrib3f(attribute("normal"), 0, 0, 0);
      for (const name of ["low", "size", "centre"]) gl.uniform3fv(this.place(name), about[name]);
      gl.uniform1f(this.place("grey"), about.grey);
      gl.enable(gl.DEPTH_TEST);
      gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
      for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, side, gl.CLAMP_TO_EDGE);
      for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
    }

    addTools() {
      const label = element("label", this.tools, {textContent: "Colour: "});
      this.chosen = element("select", label);
      for (const one of this.about.quantities) element("option", this.chosen, {textContent: one.name});
      this.chosen.addEventListener("change", () => this.choose(this.chosen.selectedIndex));
      this.bar = element("div", this.tools, {className: "bar"});
      const views = {"Reset view": () => this.reset(), "As the camera sees it": () => this.reset(0, 0)};
      for (const [text, act] of Object.entries(views)) {
        element("button", this.tools, {type: "button", textContent: text}).addEventListener("click", () => { act(); this.draw(); });
      }
    }

    choose(k) {
      const {gl} = this, one = this.about.quantities[k], colours = bytes(one.colours);
      this.bind("value", this.values[k], 1, gl.UNSIGNED_SHORT);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, 256, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, colours);
      this.lit = one.unit === "grey levels" ? 0 : 1;
      this.bar.replaceChildren();
      const stops = Array.from({length: 17}, (_, s) => `rgb(${colours.slice(3 * Math.round(15.9375 * s), 3 * Math.round(15.9375 * s) + 3).join(",")})`);
      element("div", this.bar, {className: "colours"}).style.background = `linear-gradient(to right, ${stops.join(",")})`;
      const scale = element("div", this.bar, {className: "ticks"});
      for (const text of ticks(one.low, one.high)) {
        element("span", scale, {textContent: text}).style.left = `${100 * (text - one.low) / (one.high - one.low)}%`;
      }
      element("div", this.bar, {className: "what", textContent: one.label});
      this.draw();
    }

    reset(tilt = this.about.tilt, turn = this.about.turn) {
      Object.assign(this, {tilt, turn, zoom: 1, pan: [0, 0], distance: null});
    }

    // Moves the eye so that the outermost points nearly fill the canvas, in its middle; lengths approach their limits.
    frame(rotation, reach) {
      const [a, b, c, d, e, f, g, h, i] = rotation;
      const turned = this.about.outline.map(([x, y, z]) => [a * x + d * y + g * z, b * x + e * y + h * z, c * x + f * y + i * z]);
      this.distance = 4 * this.about.radius;
      for (let step = 0; step < 30; step++) {
        let filled = 0;
        for (const k of [0, 1]) {
          const seen = turned.map(point => (point[k] + this.pan[k]) / (this.distance - point[2]));
          const [least, most] = [Math.min(...seen), Math.max(...seen)];
          this.pan[k] -= this.distance * (least + most) / 2;
          filled = Math.max(filled, (most - least) / 2 / (this.about.filled * reach[k]));
        }
        this.distance = Math.max(this.distance * filled, 1.2 * this.about.radius);
      }
    }

    draw() {
      const {gl, canvas, about} = this, ratio = window.devicePixelRatio || 1;
      const [width, height] = [canvas.clientWidth, canvas.clientHeight].map(side => Math.max(1, Math.round(side * ratio)));
      if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, {width, height});
      const half = Math.tan(about.field / 2), aspect = width / height;
      const [ct, st, cz, sz] = [Math.cos(this.tilt), Math.sin(this.tilt), Math.cos(this.turn), Math.sin(this.turn)];
      const rotation = [cz, ct * sz, -st * sz, -sz, ct * cz, -st * cz, 0, st, ct];
      if (this.distance === null) this.frame(rotation, [half * aspect, half]);
      const distance = this.distance / this.zoom;
      gl.viewport(0, 0, width, height);
      const ground = getComputedStyle(document.documentElement).getPropertyValue("--ground").trim();
      const channel = k => parseInt(ground.slice(1 + 2 * k, 3 + 2 * k), 16) / 255;
      gl.clearColor(channel(0), channel(1), channel(2), 1);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      gl.uniformMatrix3fv(this.place("rotation"), false, rotation);
      gl.uniform2f(this.place("scale"), 1 / (half * aspect), 1 / half);
      gl.uniform2fv(this.place("pan"), this.pan);
      gl.uniform1f(this.place("distance"), distance);
      gl.uniform1f(this.place("near"), Math.max(distance - 4 * about.radius, 0.02 * distance));
      gl.uniform1f(this.place("far"), distance + 4 * about.radius);
      gl.uniform1f(this.place("spacing"), 1.6 * about.spacing * height / (2 * half));
      gl.uniform1f(this.place("lit"), this.lit);
      gl.drawArrays(gl.POINTS, 0, about.points);
    }

    move(dx, dy) {
      const mm = 2 * Math.tan(this.about.field / 2) * this.distance / this.zoom / this.canvas.clientHeight;
      this.pan = [this.pan[0] + mm * dx, this.pan[1] - mm * dy];
    }

    rotate(dx, dy) {
      this.turn += 0.008 * dx;
      this.tilt = Math.min(Math.PI, Math.max(-Math.PI, this.tilt - 0.008 * dy));
    }

    magnify(factor) {
      this.zoom = Math.min(40, Math.max(0.2, this.zoom * factor));
    }

    listen() {
      const {canvas} = this, fingers = new Map();
      const spread = () => { const [a, b] = [...fingers.values()]; return Math.hypot(a[0] - b[0], a[1] - b[1]); };
      canvas.addEventListener("pointerdown", event => {
        canvas.setPointerCapture(event.pointerId);
        fingers.set(event.pointerId, [event.clientX, event.clientY]);
      });
      for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, event => fingers.delete(event.pointerId));
      canvas.addEventListener("pointermove", event => {
        const before = fingers.get(event.pointerId);
        if (!before) return;
        const [dx, dy] = [event.clientX - before[0], event.clientY - before[1]];
        const apart = fingers.size === 2 ? spread() : 0;
        fingers.set(event.pointerId, [event.clientX, event.clientY]);
        if (fingers.size === 2) { this.magnify(spread() / Math.max(apart, 1)); this.move(dx / 2, dy / 2); }
        else if (event.shiftKey || event.buttons === 2) this.move(dx, dy);
        else this.rotate(dx, dy);
        this.draw();
      });
      canvas.addEventListener("contextmenu", event => event.preventDefault());
      // Only once the view was chosen, so that the page still scrolls past it.
      canvas.addEventListener("wheel", event => {
        if (document.activeElement !== canvas) return;
        event.preventDefault();
        this.magnify(Math.exp(-0.0015 * event.deltaY));
        this.draw();
      }, {passive: false});
      canvas.addEventListener("dblclick", () => { this.reset(); this.draw(); });
      const keys = {ArrowLeft: [-12, 0], ArrowRight: [12, 0], ArrowUp: [0, -12], ArrowDown: [0, 12]};
      canvas.addEventListener("keydown", event => {
        if (keys[event.key]) this.rotate(...keys[event.key]);
        else if (event.key === "+" || event.key === "-") this.magnify(event.key === "+" ? 1.15 : 1 / 1.15);
        else return;
        event.preventDefault();
        this.draw();
      });
    }
  }

  // A view is made when it is near the window: the page opens at once, and browsers keep few contexts alive.
  const watcher = new IntersectionObserver(entries => {
    for (const entry of entries) if (entry.isIntersecting) {
      watcher.unobserve(entry.target);
      new View(entry.target);
    }
  }, {rootMargin: "200px"});
  for (const figure of document.querySelectorAll("figure.view")) watcher.observe(figure);
})();
