// SPDX-License-Identifier: Apache-2.0
// view.js: what the page of examples/gaze_page asks where `rye view` draws: this stands before page.js
// in the place of its worker. Controls of its own: accuracy, effects, and what each costs.
"use strict";

window.ryeRemote = {
    onmessage: null,
    chosen: {},      ///< accuracy and effects of the next picture
    scene: 0,        ///< number of the scene that the program shows
    live: false,     ///< something else than this page moves the head

    async postMessage(message) {
        try {
            this.onmessage({ data: message.aim ? await this.aim(message)
                                 : message.draw ? await this.draw(message) : await this.open() });
        } catch (fault) {
            const ended = fault instanceof TypeError; // of fetch
            this.onmessage({ data: { error: ended ? "rye view has ended" : fault.message, id: message.id } });
        }
    },

    async asked(path, body) {
        const answer = await fetch(path, body ? { method: "POST", body: JSON.stringify(body) } : {});
        if (!answer.ok) throw new Error(await answer.text());
        return answer;
    },

    async aim({ aim, id }) {
        const told = await this.asked("aim", aim).then((answer) => answer.json(), () => ({ aimed: null }));
        return { ...told, id };
    },

    async draw({ draw, id }) {
        const answer = await this.asked("draw", { ...draw, ...this.chosen });
        const told = JSON.parse(answer.headers.get("X-Rye"));
        const bitmap = await createImageBitmap(await answer.blob());
        return { bitmap, width: bitmap.width, height: bitmap.height, id, ...told };
    },

    async open() {
        const opened = await (await this.asked("opened")).json();
        this.scene = opened.scene;
        if (opened.waiting) throw new Error(opened.waiting);
        this.controls(opened);
        return { opened };
    },

    /// Builds the controls that the page lacks.
    controls(opened) {
        document.title = `rye view: ${opened.name || "a head"}`;
        document.querySelector(".file").hidden = true;
        for (const id of ["eyes", "head", "expression"])
            document.getElementById(id).closest("fieldset").hidden = Boolean(opened.still);
        document.getElementById("accuracy")?.closest("fieldset").remove();
        const set = document.createElement("fieldset");
        set.innerHTML = "<legend>Accuracy</legend>";
        this.chosen = { accuracy: opened.accuracy, effects: "" };
        set.append(this.choice("accuracy", "Drawn", opened.accuracies.map((n) => [n, n]), opened.accuracy));
        if (opened.effects.length > 0)
            set.append(this.choice("effects", "Effects",
                [["", "all"], ...opened.effects.map((n) => [n, n])], ""));
        const button = document.createElement("button"), table = document.createElement("table");
        button.type = "button";
        button.id = "prices";
        button.textContent = "What each costs here";
        table.id = "costs";
        button.onclick = async () => {
            button.disabled = true;
            try {
                this.table(table, await (await this.asked("prices", {})).json());
            } catch (fault) {
                notice(fault.message, true);
            }
            button.disabled = false;
        };
        set.append(button, table);
        const controls = document.getElementById("controls");
        controls.insertBefore(set, controls.querySelector("fieldset"));
    },

    choice(key, title, values, value) {
        const label = document.createElement("label"), select = document.createElement("select");
        label.className = "row";
        label.append(title, select);
        select.id = key;
        for (const [name, text] of values) select.add(new Option(text, name, false, name === value));
        select.onchange = () => {
            this.chosen[key] = select.value;
            want({ motion: orbit.motion() });
        };
        return label;
    },

    table(table, prices) {
        const row = (cells, tag = "td") => {
            const tr = document.createElement("tr");
            for (const text of cells) tr.append(Object.assign(document.createElement(tag), { textContent: text }));
            return tr;
        };
        const last = prices[prices.length - 1].accuracy;
        table.replaceChildren(row(["", "ms", `most from ${last}`, "mean"], "th"), ...prices.map((p) =>
            row([p.accuracy, p.ms.toFixed(1), `${(255 * p.most).toFixed(1)}/255`, `${(255 * p.mean).toFixed(2)}/255`])));
    },

    /// Asks each second whether the scene is another one, and what a training says.
    async hearNews() {
        try {
            const news = await (await this.asked("news")).json();
            this.live = news.live;
            const hint = document.getElementById("hint");
            if (news.words) hint.textContent = news.words;
            if (news.words) hint.classList.remove("gone");
            if (news.scene !== this.scene) {
                this.scene = news.scene;
                if (avatar) want({ motion: orbit.motion() });
                else this.postMessage({ open: null });
            }
        } catch (fault) {
            notice(fault instanceof TypeError ? "rye view has ended" : fault.message, true);
            return;
        }
        setTimeout(() => this.hearNews(), 1000);
    },
    follow() {
        if (this.live && avatar && !busy) want({ motion: orbit.motion() });
        requestAnimationFrame(() => this.follow());
    },
};
window.addEventListener("load", () => {
    window.ryeRemote.hearNews();
    window.ryeRemote.follow();
});
