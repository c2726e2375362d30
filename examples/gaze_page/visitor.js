// SPDX-License-Identifier: Apache-2.0
// visitor.js: the page's camera. "Look back at me": the eyes look at the visitor's; "Drive by my face":
// expression and gaze are the visitor's. MediaPipe's Face Landmarker, which build.sh puts beside the page,
// finds the face here; no picture is kept or sent. What is missing is a sentence, and the page goes on.
"use strict";

(() => {
    const each = 66;           // [ms] from one look to the next
    const radiusOfHead = 12;   // [cm], of the sphere that avatar.radius is of
    const buttons = { look: "Look back at me", drive: "Drive by my face" };
    let mode = null, landmarker = null, stream = null;
    const video = document.createElement("video");
    video.muted = video.playsInline = true;

    const box = document.createElement("fieldset"), sentence = document.createElement("p");
    box.innerHTML = "<legend>Camera</legend>";
    sentence.id = "visitor";
    sentence.setAttribute("role", "status");
    for (const [name, text] of Object.entries(buttons)) {
        const button = document.createElement("button");
        Object.assign(button, { type: "button", id: name, textContent: text });
        button.setAttribute("aria-pressed", "false");
        button.onclick = () => (mode === name ? stop("") : start(name));
        box.append(button, " ");
    }
    box.append(sentence);
    element("controls").querySelector("fieldset").after(box);

    function say(text) {
        if (sentence.textContent !== text) sentence.textContent = text;
    }
    function press(name) {
        mode = name;
        for (const b of Object.keys(buttons)) element(b).setAttribute("aria-pressed", String(b === name));
    }
    function stop(text) {
        press(null);
        for (const track of stream?.getTracks() ?? []) track.stop();
        stream = null;
        say(text);
    }

    async function openCamera() {
        if (!navigator.mediaDevices) throw new Error("Browsers give a camera to pages of https alone.");
        const faults = {
            NotAllowedError: "The camera was not allowed.",
            NotFoundError: "There is no camera.",
            NotReadableError: "Another program has the camera.",
        };
        return navigator.mediaDevices.getUserMedia({ video: { width: 640, height: 480, facingMode: "user" } })
            .catch((fault) => { throw new Error(faults[fault.name] ?? `No camera: ${fault.message}.`); });
    }
    async function openLandmarker() {
        if (location.protocol === "file:") throw new Error("The camera needs a page from a host, not from a disk.");
        const folder = new URL("mediapipe/", location.href).href;
        const { FaceLandmarker, FilesetResolver } = await import(`${folder}vision_bundle.mjs`).catch(() => {
            throw new Error("This page was built without MediaPipe, which finds faces.");
        });
        return FaceLandmarker.createFromOptions(await FilesetResolver.forVisionTasks(`${folder}wasm`), {
            baseOptions: { modelAssetPath: `${folder}face_landmarker.task`, delegate: "CPU" },
            runningMode: "VIDEO", numFaces: 1, outputFaceBlendshapes: true,
            outputFacialTransformationMatrixes: true,
        });
    }

    async function start(name) {
        if (!avatar) return say("There is no avatar yet.");
        const running = stream !== null;
        press(name);
        if (running) return;
        say("Starting…");
        try {
            landmarker ??= await openLandmarker();
            stream = await openCamera();
            video.srcObject = stream;
            await video.play();
            stream.getVideoTracks()[0].onended = () => stop("The camera has ended.");
            if (mode === null) return stop("");
            element("follow").checked = false;
            say("Nothing leaves this device.");
            look(stream);
        } catch (fault) {
            stop(`${fault.message} The page goes on without.`);
        }
    }

    /// Looks for the face, as long as the camera is this one.
    function look(from) {
        if (stream !== from || mode === null) return;
        try {
            const found = landmarker.detectForVideo(video, performance.now());
            if (found.faceLandmarks.length > 0) {
                touched();
                seen(found);
                say("Nothing leaves this device.");
            } else {
                say("No face in sight.");
            }
        } catch (fault) {
            return stop(`MediaPipe failed: ${fault.message}. The page goes on without.`);
        }
        setTimeout(look, each, from);
    }

    function seen({ faceLandmarks: [landmarks], faceBlendshapes: [{ categories }],
                    facialTransformationMatrixes: [{ data }] }) {
        if (mode === "look") {
            const cm = avatar.radius / radiusOfHead;
            const [right, up, before] = Face.place(landmarks, data, video.videoWidth, video.videoHeight);
            // The camera looks out of the page, as the head does: its right is the page's left.
            const asked = goals;
            gazeTo([-right * cm, up * cm, before * cm]).then((angles) => { if (asked === goals) goal = angles; });
            return;
        }
        const names = categories.map((c) => c.categoryName), scores = categories.map((c) => c.score);
        const from = Face.sources(names, avatar.names);
        expression = Face.expression(from, scores, avatar, expression);
        expressionSliders.forEach((s, i) => s.set(expression[i]));
        const angles = Face.gaze(names, scores);
        ++goals;
        if (angles) goal = [0, 1].flatMap((eye) => within(eye, ...angles.slice(2 * eye, 2 * eye + 2)));
        gaze = [...goal];      // as soon as the expression
        showGaze();
        want({ gaze, expression });
    }
})();
