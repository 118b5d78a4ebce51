// Headless Chromium through a pipe: node chromium.js PROGRAM, JSON {url, width, height, steps} from stdin.
// Each step is an expression that the page evaluates or {drag: [[x, y], ...]}; prints the values.
const { spawn } = require("child_process"), fs = require("fs"), os = require("os"), path = require("path");
const { url, width, height, steps } = JSON.parse(fs.readFileSync(0, "utf8"));
const home = fs.mkdtempSync(path.join(os.tmpdir(), "chromium-"));
const options = ["--headless=new", "--no-sandbox", "--disable-gpu", "--remote-debugging-pipe", `--user-data-dir=${home}`];
const browser = spawn(process.argv[2], options, { stdio: ["ignore", "ignore", "ignore", "pipe", "pipe"] });
const [to, from] = browser.stdio.slice(3), waiting = new Map(), happened = new Map();
let rest = "", count = 0;
from.on("data", (part) => {
  const told = (rest + part).split("\0");
  rest = told.pop();
  for (const one of told.map((text) => JSON.parse(text))) {
    waiting.get(one.id)?.(one.result ?? one);
    happened.get(one.method)?.();
  }
});
const send = (method, params = {}, sessionId) => new Promise((done) => {
  waiting.set(++count, done);
  to.write(JSON.stringify({ id: count, method, params, sessionId }) + "\0");
});
(async () => {
  const { targetId } = await send("Target.createTarget", { url: "about:blank" });
  const { sessionId } = await send("Target.attachToTarget", { targetId, flatten: true });
  const call = (method, params) => send(method, params, sessionId);
  const loaded = new Promise((done) => happened.set("Page.loadEventFired", done));
  await call("Page.enable");
  await call("Emulation.setDeviceMetricsOverride", { width, height, deviceScaleFactor: 1, mobile: width < 600 });
  await call("Page.navigate", { url });
  await loaded;
  await new Promise((done) => setTimeout(done, 300));
  const found = [];
  for (const step of steps) {
    if (step.drag) {
      const mouse = (type, [x, y]) => call("Input.dispatchMouseEvent", { type, x, y, button: "left", buttons: 1, clickCount: 1 });
      await mouse("mousePressed", step.drag[0]);
      for (const at of step.drag) await mouse("mouseMoved", at);
      await mouse("mouseReleased", step.drag.at(-1));
    } else {
      const { result, exceptionDetails } = await call("Runtime.evaluate", { expression: step, returnByValue: true, awaitPromise: true });
      found.push(exceptionDetails ? exceptionDetails.exception.description : result.value);
    }
  }
  console.log(JSON.stringify(found));
  const gone = new Promise((done) => browser.on("exit", done));
  send("Browser.close");
  await gone;
  fs.rmSync(home, { recursive: true, force: true, maxRetries: 20, retryDelay: 100 });
})();
