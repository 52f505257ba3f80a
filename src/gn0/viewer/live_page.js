// Runs before viser's own script, and only where WebGL has no GPU under it.
//
// A software rasteriser draws the instances of a draw call one by one: 30,000 splats are 30,000
// small draws. Here the same quads are laid out one after another and drawn in one go; the picture
// is the same. Multisampling is left out, for a splat has no hard edge.
(() => {
  "use strict";
  const context = HTMLCanvasElement.prototype.getContext;
  let known = null;
  const software = () => {
    if (known === null) {
      const gl = context.call(document.createElement("canvas"), "webgl2");
      const info = gl && gl.getExtension("WEBGL_debug_renderer_info");
      const name = info ? String(gl.getParameter(info.UNMASKED_RENDERER_WEBGL)) : "";
      known = /swiftshader|llvmpipe|software|basic render/i.test(name);
      const lose = gl && gl.getExtension("WEBGL_lose_context");
      if (lose) lose.loseContext();
    }
    return known;
  };
  HTMLCanvasElement.prototype.getContext = function (kind, options) {
    if (kind === "webgl2" && software()) options = { ...options, antialias: false };
    return context.call(this, kind, options);
  };

  const GL = WebGL2RenderingContext.prototype;
  const { bufferData, bufferSubData, drawElementsInstanced } = GL;
  const contents = new WeakMap(); // buffer -> {array, version}: what viser put into it last
  const note = (gl, target, array) => {
    if (!known || !ArrayBuffer.isView(array)) return;
    const index = target === gl.ELEMENT_ARRAY_BUFFER;
    if (!index && target !== gl.ARRAY_BUFFER) return;
    const buffer = gl.getParameter(
      index ? gl.ELEMENT_ARRAY_BUFFER_BINDING : gl.ARRAY_BUFFER_BINDING,
    );
    if (buffer) contents.set(buffer, { array, version: (contents.get(buffer)?.version ?? 0) + 1 });
  };
  GL.bufferData = function (target, data, ...rest) {
    note(this, target, data);
    return bufferData.call(this, target, data, ...rest);
  };
  GL.bufferSubData = function (target, offset, data, ...rest) {
    if (offset === 0 && rest.length === 0) note(this, target, data);
    return bufferSubData.call(this, target, offset, data, ...rest);
  };

  const places = new WeakMap(); // program -> {order, corner}: attribute locations, or null
  const flats = new WeakMap(); // buffer of the order -> the laid-out copy
  const find = (gl, program) => {
    if (!places.has(program)) {
      const order = gl.getAttribLocation(program, "sortedIndex");
      const corner = gl.getAttribLocation(program, "position");
      places.set(program, order < 0 || corner < 0 ? null : { order, corner });
    }
    return places.get(program);
  };
  const fill = (gl, target, array) => {
    const buffer = gl.createBuffer();
    gl.bindBuffer(target, buffer);
    bufferData.call(gl, target, array, gl.DYNAMIC_DRAW);
    return buffer;
  };
  // Vertex arrays of `count` quads: corners and indices for good, the order to be written anew.
  const lay = (gl, place, corners, faces, count) => {
    const points = corners.length / 2;
    const many = new Float32Array(corners.length * count);
    const index = new Uint32Array(faces.length * count);
    for (let i = 0; i < count; i++) {
      many.set(corners, corners.length * i);
      for (let k = 0; k < faces.length; k++) index[faces.length * i + k] = faces[k] + points * i;
    }
    const vao = gl.createVertexArray();
    gl.bindVertexArray(vao);
    fill(gl, gl.ARRAY_BUFFER, many);
    gl.enableVertexAttribArray(place.corner);
    gl.vertexAttribPointer(place.corner, 2, gl.FLOAT, false, 0, 0);
    const order = new Uint32Array(points * count);
    const buffer = fill(gl, gl.ARRAY_BUFFER, order);
    gl.enableVertexAttribArray(place.order);
    gl.vertexAttribIPointer(place.order, 1, gl.UNSIGNED_INT, 0, 0);
    fill(gl, gl.ELEMENT_ARRAY_BUFFER, index);
    return { vao, order, buffer, points, count, place, version: -1 };
  };
  const draw = (gl, count, faceCount) => {
    const program = gl.getParameter(gl.CURRENT_PROGRAM);
    const place = program && find(gl, program);
    if (!place) return false;
    const bound = (at) => gl.getVertexAttrib(at, gl.VERTEX_ATTRIB_ARRAY_BUFFER_BINDING);
    const source = bound(place.order);
    const order = source && contents.get(source);
    const corners = contents.get(bound(place.corner));
    const faces = contents.get(gl.getParameter(gl.ELEMENT_ARRAY_BUFFER_BINDING));
    if (!order || !corners || !faces) return false;
    if (order.array.length < count || faces.array.length !== faceCount) return false;
    const vao = gl.getParameter(gl.VERTEX_ARRAY_BINDING);
    const array = gl.getParameter(gl.ARRAY_BUFFER_BINDING);
    let flat = flats.get(source);
    if (!flat || flat.count !== count || flat.place !== place) {
      if (flat) gl.deleteVertexArray(flat.vao);
      flat = lay(gl, place, corners.array, faces.array, count);
      flats.set(source, flat);
    }
    if (flat.version !== order.version) {
      for (let i = 0; i < count; i++) {
        flat.order.fill(order.array[i], flat.points * i, flat.points * (i + 1));
      }
      gl.bindBuffer(gl.ARRAY_BUFFER, flat.buffer);
      bufferSubData.call(gl, gl.ARRAY_BUFFER, 0, flat.order);
      flat.version = order.version;
    }
    gl.bindVertexArray(flat.vao);
    gl.drawElements(gl.TRIANGLES, faceCount * count, gl.UNSIGNED_INT, 0);
    gl.bindVertexArray(vao);
    gl.bindBuffer(gl.ARRAY_BUFFER, array);
    return true;
  };
  GL.drawElementsInstanced = function (mode, faceCount, type, offset, count) {
    const splats = known && count >= 256 && faceCount === 6 && offset === 0;
    if (splats && mode === this.TRIANGLES && draw(this, count, faceCount)) {
      window.gn0Frames = (window.gn0Frames ?? 0) + 1;
      return;
    }
    if (count >= 256) window.gn0Frames = (window.gn0Frames ?? 0) + 1;
    drawElementsInstanced.call(this, mode, faceCount, type, offset, count);
  };
})();
