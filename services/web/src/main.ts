import { mount } from "svelte";
import App from "./App.svelte";
import "./page.css";

const target = document.getElementById("page");
if (target === null) throw new Error("the page has no place for itself");
mount(App, { target });
