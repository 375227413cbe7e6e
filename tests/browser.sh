#!/usr/bin/env bash
# The library in a browser: builds examples/browser, runs it in headless Chromium on SwiftShader, and compares the
# energies of its first frames with those of the CPU path. Needs the target wasm32-unknown-unknown (rustup target add),
# wasm-bindgen in the version of Cargo.lock (cargo install wasm-bindgen-cli), python3 and Chromium. Run by hand.
set -euo pipefail
cd "$(dirname "$0")/.."
target=${CARGO_TARGET_DIR:-target}
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
cargo build --release --no-default-features --features weights --example browser --target wasm32-unknown-unknown
wasm-bindgen --target web --no-typescript --out-dir "$scratch" "$target/wasm32-unknown-unknown/release/examples/browser.wasm"
cp examples/browser/index.html "$scratch"
cargo run --release -- rollout --device cpu --frames 4 --no-pictures --out "$scratch/native"
python3 - "$scratch" "${CHROMIUM:-chromium}" <<'END'
import functools, http.server, json, pathlib, re, subprocess, sys, threading, time

folder, chromium = pathlib.Path(sys.argv[1]), sys.argv[2]
# The page posts every line that it shows.
watch = """<script>new MutationObserver(changes => {
  for (const node of changes.flatMap(change => [...change.addedNodes])) fetch("/said", { method: "POST", body: node.textContent });
}).observe(document.querySelector("p"), { childList: true });</script>"""
page = folder / "index.html"
page.write_text(page.read_text().replace("</html>", watch + "</html>"))
said = []

class Handler(http.server.SimpleHTTPRequestHandler):
    def do_POST(self):
        said.append(self.rfile.read(int(self.headers["Content-Length"])).decode())
        self.send_response(204)
        self.end_headers()

    def log_message(self, *_):
        pass

server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Handler, directory=folder))
threading.Thread(target=server.serve_forever, daemon=True).start()
software = "--use-webgpu-adapter=swiftshader --use-vulkan=swiftshader --use-gl=angle --use-angle=swiftshader"
options = f"--headless=new --no-sandbox --enable-unsafe-webgpu --enable-features=Vulkan {software}".split()
browser = subprocess.Popen(
    [chromium, *options, f"--user-data-dir={folder}/profile", f"http://127.0.0.1:{server.server_port}/"],
    stdout=subprocess.DEVNULL,
    stderr=subprocess.DEVNULL,
)
native = {f["frame"]: f["energy_total"] for f in json.loads((folder / "native/report.json").read_text())["per_frame"]}
found, end = {}, time.monotonic() + 180
while len(found) < len(native) and time.monotonic() < end:
    time.sleep(0.5)
    lines = [re.match(r"frame (\d+), energy ([\d.]+)", line) for line in said]
    found = {int(m[1]): float(m[2]) for m in lines if m and int(m[1]) in native}
browser.terminate()
browser.wait()
for frame, energy in native.items():
    print(f"frame {frame}: energy {found.get(frame)} in the browser, {energy:.6f} on the CPU")
same = all(abs(found.get(frame, 0) / energy - 1) < 1e-3 for frame, energy in native.items())
print("done" if same else f"browser: frames are missing or differ; the page said {said[-1:]}")
sys.exit(not same)
END
