// Draws the robot, away from the page's main thread: there a frame of software GL would hold up a press of the stop.
import { Scene3d } from "./scene3d.js";

/** @type {Scene3d | null} */
let scene = null;

onmessage = ({ data }) => {
  if (data.t === "canvas") {
    try {
      scene = new Scene3d(data.canvas, data.colours, (drawn) => postMessage({ t: "drawn", ...drawn }));
      postMessage({ t: "ready" });
    } catch (error) {
      postMessage({ t: "failed", text: String(error instanceof Error ? error.message : error) });
    }
    return;
  }
  if (!scene) return;
  try {
    if (data.t === "robot") scene.setRobot(data.robot);
    else if (data.t === "poses") scene.setPoses(data);
    else if (data.t === "trail") scene.setTrail(data.points);
    else if (data.t === "size") scene.resize(data.width, data.height, data.ratio);
    else if (data.t === "colours") scene.setColours(data.colours);
    else if (data.t === "input") scene.input(data.event);
    else if (data.t === "reset") scene.resetView();
  } catch (error) {
    postMessage({ t: "failed", text: String(error instanceof Error ? error.message : error) });
  }
};
