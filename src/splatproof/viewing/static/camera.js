// Where the page's camera stands: a target, a distance, heading, pitch and roll; orbit and fly change the same.
"use strict";
(() => {
  const S = splatproof;
  const V = S.vector = {
    add: (a, b) => a.map((x, i) => x + b[i]),
    sub: (a, b) => a.map((x, i) => x - b[i]),
    mul: (a, s) => a.map((x) => x * s),
    dot: (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2],
    cross: (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]],
    mix: (a, s, b, t) => a.map((x, i) => s * x + t * b[i]),
  };
  const STEEPEST = Math.PI / 2 - 1e-3;

  class Camera {
    // place: centre, radius, up, across as the server gives them.
    constructor(place, fov) {
      this.place = place;
      this.axes = [place.across, V.cross(place.up, place.across), place.up];
      Object.assign(this, { target: place.centre, distance: place.radius, heading: 0, pitch: -0.3, roll: 0, fov });
    }
    // right, up, forward of the image.
    get basis() {
      const [a, b, u] = this.axes, c = Math.cos(this.heading), s = Math.sin(this.heading);
      const flat = V.mix(a, c, b, s), right = V.mix(a, s, b, -c);
      const forward = V.mix(flat, Math.cos(this.pitch), u, Math.sin(this.pitch));
      const up = V.cross(right, forward);
      const rc = Math.cos(this.roll), rs = Math.sin(this.roll);
      return { right: V.mix(right, rc, up, rs), up: V.mix(up, rc, right, -rs), forward };
    }
    get eye() { return V.sub(this.target, V.mul(this.basis.forward, this.distance)); }
    // Stand where a view of the scene was taken; rotation: rows right, down, forward.
    stand({ centre, rotation: [right, down, forward], height, focal }) {
      const [a, b, u] = this.axes, sine = V.dot(forward, u);
      this.pitch = Math.asin(Math.max(-1, Math.min(1, sine)));
      // straight down or up the heading is that of the image's upper edge
      const flat = Math.abs(sine) < 0.998 ? forward : V.mul(down, sine < 0 ? -1 : 1);
      this.heading = Math.atan2(V.dot(flat, b), V.dot(flat, a));
      this.roll = 0;
      const level = this.basis;
      this.roll = Math.atan2(V.dot(right, level.up), V.dot(right, level.right));
      const ahead = V.dot(V.sub(this.place.centre, centre), forward);
      this.distance = Math.max(ahead, 0.2 * this.place.radius);
      this.target = V.add(centre, V.mul(forward, this.distance));
      this.fov = 2 * Math.atan(height / 2 / focal[1]) * 180 / Math.PI;
    }
    turn(dh, dp, around) {
      const eye = this.eye;
      this.heading += dh;
      this.pitch = Math.max(-STEEPEST, Math.min(STEEPEST, this.pitch + dp));
      this.roll *= 0.9; // what photos were tilted by goes away while one turns
      if (!around) this.target = V.add(eye, V.mul(this.basis.forward, this.distance));
    }
    shift(x, y, z) {
      const { right, up, forward } = this.basis;
      this.target = V.add(V.add(this.target, V.mul(right, x)), V.add(V.mul(up, y), V.mul(forward, z)));
    }
    zoom(factor) { this.distance = Math.max(1e-3 * this.place.radius, Math.min(100 * this.place.radius, this.distance * factor)); }
    // What a frame needs to know, kept as it was when the frame was asked for.
    now() { return { ...this.basis, eye: this.eye, fov: this.fov }; }
  }
  S.Camera = Camera;
  // Pixel and depth of a point for a camera of `now()` in an image of this size.
  S.project = (camera, [width, height], point) => {
    const d = V.sub(point, camera.eye), z = V.dot(d, camera.forward);
    const focal = height / 2 / Math.tan(camera.fov * Math.PI / 360);
    return [width / 2 + focal * V.dot(d, camera.right) / z, height / 2 - focal * V.dot(d, camera.up) / z, z];
  };
})();
