// What the page uses of three and CodeMirror. `sh build.sh` bundles it into ../static/vendor.js.
export {
  BoxGeometry, BufferAttribute, BufferGeometry, CapsuleGeometry, Color, CylinderGeometry, DirectionalLight, GridHelper,
  Group, HemisphereLight, Mesh, MeshLambertMaterial,
  PerspectiveCamera, Quaternion, Scene, SphereGeometry, Vector3, WebGLRenderer,
} from 'three';
export { OrbitControls } from 'three/examples/jsm/controls/OrbitControls.js';
export { TransformControls } from 'three/examples/jsm/controls/TransformControls.js';
export { EditorState, Prec } from '@codemirror/state';
export { EditorView, keymap, placeholder } from '@codemirror/view';
export { defaultKeymap, history, historyKeymap } from '@codemirror/commands';
export { acceptCompletion, autocompletion, closeCompletion, completionStatus, startCompletion, moveCompletionSelection }
  from '@codemirror/autocomplete';
export { setDiagnostics } from '@codemirror/lint';
