// Checks a rollout's glTF file with Khronos' validator (`npm install gltf-validator`): no error and no warning.
//
//     node tests/tools/gltf.js FOLDER

const fs = require("fs");
const path = require("path");
const validator = require("gltf-validator");

const bytes = new Uint8Array(fs.readFileSync(path.join(process.argv[2], "rollout.glb")));
validator.validateBytes(bytes).then((report) => {
    const { numErrors, numWarnings, messages } = report.issues;
    console.log(`glTF: ${numErrors} errors, ${numWarnings} warnings`);
    if (numErrors + numWarnings > 0) {
        console.log(messages);
        process.exitCode = 1;
    }
});
