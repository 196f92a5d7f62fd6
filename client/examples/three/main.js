// @ts-check
/** A monument on a plaza, by three.js, under the sky of a Skycell server. */

import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { SkyBackground } from "./sky-background.js";

const canvas = document.getElementById("scene");
const told = document.getElementById("told");
if (!(canvas instanceof HTMLCanvasElement) || !told) throw new Error("the page has no canvas");

const query = new URLSearchParams(location.search);
const width = Number(query.get("width") ?? 960);
const height = Number(query.get("height") ?? 540);

const renderer = new THREE.WebGLRenderer({ canvas, antialias: true, preserveDrawingBuffer: query.has("keep") });
const scene = new THREE.Scene();
const camera = new THREE.PerspectiveCamera(60, 16 / 9, 0.1, 2000);
camera.position.set(0, 2.2, 14);
const controls = new OrbitControls(camera, canvas);
controls.target.set(0, 4.5, 0);
controls.maxPolarAngle = 0.62 * Math.PI;
controls.update();

const stone = new THREE.MeshStandardMaterial({ color: 0xd8cfc0, roughness: 0.8 });
const metal = new THREE.MeshStandardMaterial({ color: 0xc98c4b, roughness: 0.3, metalness: 0.4 });
const knot = new THREE.Mesh(new THREE.TorusKnotGeometry(1.6, 0.45, 160, 24), metal);
knot.position.y = 5;
const column = new THREE.Mesh(new THREE.CylinderGeometry(1.2, 1.5, 2.6, 32), stone);
column.position.y = 1.3;
const plaza = new THREE.Mesh(new THREE.CylinderGeometry(18, 18, 0.2, 64), stone);
plaza.position.y = -0.1;
scene.add(knot, column, plaza, new THREE.HemisphereLight(0xbfd8ff, 0x6b6355, 1.4));
const sun = new THREE.DirectionalLight(0xfff1dc, 2.5);
sun.position.set(5, 8, 6);
scene.add(sun);

const url = new URL("/ws", location.href);
url.protocol = location.protocol === "https:" ? "wss:" : "ws:";
url.search = "";
const sky = new SkyBackground(url, camera, { width, height });
scene.add(sky.mesh);
sky.connection.onStatus(({ message, latency_ms }) => {
  const text = latency_ms === null ? message : `${message}, ${latency_ms.toFixed(0)} ms`;
  if (told.textContent !== text) told.textContent = text;
});

new ResizeObserver(() => {
  const { clientWidth, clientHeight } = canvas;
  renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
  renderer.setSize(clientWidth, clientHeight, false);
  camera.aspect = clientWidth / clientHeight;
  camera.updateProjectionMatrix();
}).observe(canvas);

renderer.setAnimationLoop((time_ms) => {
  knot.rotation.y = time_ms / 4000;
  controls.update();
  sky.update();
  renderer.render(scene, camera);
});

// For tests and the console.
Object.assign(window, { example: { sky, camera, knot, renderer } });
