// Shaders of what is no solid: the floor's grid, the reference, the trail.
import * as THREE from "./vendor/three.js";

/** A grid of 1 m, finer lines of 0.25 m, that fades into the page before it reaches its own edge. */
export const floorMaterial = () => new THREE.ShaderMaterial({
  transparent: true, depthWrite: false,
  uniforms: { line: { value: new THREE.Color() }, strength: { value: 0.6 } },
  vertexShader: `
    varying vec2 world; varying vec2 local;
    void main() { local = position.xy; vec4 at = modelMatrix * vec4(position, 1.0); world = at.xy; gl_Position = projectionMatrix * viewMatrix * at; }`,
  fragmentShader: `
    varying vec2 world; varying vec2 local; uniform vec3 line; uniform float strength;
    float grid(float step) {
      vec2 at = world / step, wide = fwidth(at);
      vec2 near = abs(fract(at - 0.5) - 0.5) / wide;
      return (1.0 - min(min(near.x, near.y), 1.0)) * clamp(0.35 / max(wide.x, wide.y), 0.0, 1.0);
    }
    void main() {
      float away = length(local);
      float fade = pow(clamp(1.0 - away / 7.0, 0.0, 1.0), 1.6);
      float fine = grid(0.25) * 0.3 * clamp(1.0 - away / 2.6, 0.0, 1.0);
      gl_FragColor = vec4(line, max(grid(1.0), fine) * fade * strength);
      #include <colorspace_fragment>
    }`,
});

/** The reference: bright where its surface turns away, nearly nothing where it faces the eye. Orange, as `asked` in plots. */
export const ghostMaterial = () => new THREE.ShaderMaterial({
  transparent: true, depthWrite: false,
  uniforms: { colour: { value: new THREE.Color("#f59e42") }, strength: { value: 1 } },
  vertexShader: `
    varying vec3 normal_view; varying vec3 to_eye;
    void main() { vec4 at = modelViewMatrix * vec4(position, 1.0); normal_view = normalMatrix * normal; to_eye = -at.xyz; gl_Position = projectionMatrix * at; }`,
  fragmentShader: `
    varying vec3 normal_view; varying vec3 to_eye; uniform vec3 colour; uniform float strength;
    void main() {
      float rim = 1.0 - abs(dot(normalize(normal_view), normalize(to_eye)));
      gl_FragColor = vec4(colour, min(0.9, strength * (0.10 + 0.55 * rim * rim)));
      #include <colorspace_fragment>
    }`,
});

export const trailMaterial = () => new THREE.ShaderMaterial({
  transparent: true, depthWrite: false, side: 2,
  uniforms: { colour: { value: new THREE.Color() } },
  vertexShader: `
    attribute float fade; varying float shown;
    void main() { shown = fade; gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0); }`,
  fragmentShader: `
    varying float shown; uniform vec3 colour;
    void main() { gl_FragColor = vec4(colour, 0.75 * shown * shown);
      #include <colorspace_fragment>
    }`,
});
