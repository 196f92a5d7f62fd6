// @ts-check
/**
 * A Skycell sky as the background of a three.js scene: the last frame, turned to where three's camera looks now. The sky is far
 * away, so small steps of the camera show nothing; its place is told to the server all the same.
 */

import * as THREE from "three";
import { connect, unixMicros } from "../../web/connection.js";
import { LOOK_UP_GLSL, axes, halfTangents, rotationBetween, withMargin } from "../../web/warp.js";

/** @typedef {import("../../web/look.js").Camera} Camera */

const DEG = Math.PI / 180;
const MARGIN = 0.25;

/**
 * Right, up and ahead of a camera of three in the world. Both worlds have x to the right, y up, and north at −z.
 * @param {THREE.Camera} camera
 */
export function axesOf(camera) {
  const [right, up, back] = [new THREE.Vector3(), new THREE.Vector3(), new THREE.Vector3()];
  camera.updateMatrixWorld();
  camera.matrixWorld.extractBasis(right, up, back);
  return [right.normalize().toArray(), up.normalize().toArray(), back.normalize().negate().toArray()];
}

/**
 * What Skycell is to look at. It knows no roll: a rolled camera sees its picture turned.
 * @param {THREE.PerspectiveCamera} camera
 * @returns {Camera}
 */
export function lookOf(camera) {
  const ahead = axesOf(camera)[2];
  const place = camera.getWorldPosition(new THREE.Vector3());
  return {
    position_m: [place.x, Math.max(place.y, 1), place.z],
    yaw_deg: Math.atan2(ahead[0], -ahead[2]) / DEG,
    pitch_deg: Math.asin(Math.max(-1, Math.min(1, ahead[1]))) / DEG,
    vertical_fov_deg: camera.fov,
  };
}

export class SkyBackground {
  #texture = new THREE.Texture();
  /** @type {ImageBitmap | null} */ #bitmap = null;
  /** @type {{ camera: Camera, size: { width: number, height: number } } | null} */ #shot = null;
  #max = { width: 3840, height: 2160 };
  frames = 0;

  /**
   * @param {string | URL} url  of the server's /ws
   * @param {THREE.PerspectiveCamera} camera
   * @param {{ width: number, height: number, fps?: number }} size  of the pictures, pixels
   */
  constructor(url, camera, { width, height, fps = 20 }) {
    this.camera = camera;
    this.size = { width, height };
    this.#texture.colorSpace = THREE.NoColorSpace; // it is as a screen wants it already
    this.#texture.flipY = false;
    this.#texture.generateMipmaps = false;
    this.#texture.minFilter = THREE.LinearFilter;
    const material = new THREE.ShaderMaterial({
      vertexShader: "varying vec2 place; void main() { place = position.xy; gl_Position = vec4(position.xy, 1.0, 1.0); }",
      fragmentShader: `uniform sampler2D picture; varying vec2 place; ${LOOK_UP_GLSL}
        void main() { gl_FragColor = vec4(texture2D(picture, look_up(place)).rgb, 1.0); }`,
      uniforms: {
        picture: { value: this.#texture },
        picture_from_shown: { value: new THREE.Matrix3() },
        shown_tan: { value: new THREE.Vector2(1, 1) },
        picture_tan: { value: new THREE.Vector2(1, 1) },
      },
      depthTest: false,
      depthWrite: false,
      toneMapped: false,
    });
    this.material = material;
    this.mesh = new THREE.Mesh(new THREE.PlaneGeometry(2, 2), material);
    this.mesh.frustumCulled = false;
    this.mesh.renderOrder = -Infinity;
    const asked = withMargin(lookOf(camera), this.size, MARGIN, this.#max);
    this.connection = connect(url, { view: { ...asked.size, fps, codec: "jpeg" }, camera: asked.camera });
    this.connection.onFrame((frame) => void this.#take(frame));
  }

  /** Before every picture of three's. */
  update() {
    const look = lookOf(this.camera);
    this.connection.setCamera(withMargin(look, this.size, MARGIN, this.#max).camera);
    if (!this.#shot) return;
    const { uniforms } = this.material;
    uniforms.picture_from_shown.value.fromArray(rotationBetween(axesOf(this.camera), axes(this.#shot.camera)));
    const up = Math.tan((this.camera.fov / 2) * DEG);
    uniforms.shown_tan.value.set(up * this.camera.aspect, up);
    uniforms.picture_tan.value.fromArray(halfTangents(this.#shot.camera, this.#shot.size));
  }

  /** @param {import("../../web/connection.js").Frame} frame */
  async #take(frame) {
    const started_ms = performance.now();
    try {
      const blob = new Blob([frame.payload], { type: `image/${frame.header.codec}` });
      const bitmap = await createImageBitmap(blob, { colorSpaceConversion: "none" });
      if (frame.camera) {
        const before = this.#bitmap;
        // A texture's storage is as large as its first picture.
        if (before && (before.width !== bitmap.width || before.height !== bitmap.height)) this.#texture.dispose();
        this.#bitmap = bitmap;
        this.#texture.image = bitmap;
        this.#texture.needsUpdate = true;
        before?.close();
        this.#shot = { camera: frame.camera, size: { width: bitmap.width, height: bitmap.height } };
        this.frames += 1;
      } else {
        bitmap.close();
      }
    } finally {
      // Every frame wants its acknowledgement, a broken one as well.
      frame.presented({ decode_us: (performance.now() - started_ms) * 1000, present_us: unixMicros() });
    }
  }

  dispose() {
    this.connection.close();
    this.#texture.dispose();
    this.material.dispose();
    this.mesh.geometry.dispose();
  }
}
