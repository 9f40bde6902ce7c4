// What is compiled of the collision checks and of the search (decisions 0069, 0093), which `boxes.py` prepares, and
// of the kinematics and the pace.

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include "_boxes.hpp"
#include "_kinematics.hpp"
#include "_pace.hpp"
#include "_puma.hpp"
#include "_separation.hpp"
#include "_trees.hpp"

PYBIND11_MODULE(_boxes, module) {
    module.attr("VERSION") = 4;  // `KERNEL` of __init__.py: another one when a function is added or changes its arguments
    module.def("squared_pace", &squared_pace);
    py::class_<Arm>(module, "Arm").def(py::init<Ints, Ints, Doubles, Doubles, Doubles>()).def("turned_to", &Arm::turned_to);
    py::class_<Puma>(module, "Puma")
        .def(py::init<Doubles, Doubles, Doubles, Doubles>())
        .def("along", &Puma::along)
        .def("line", &Puma::line)
        .def("within", &Puma::within);
    py::class_<Boxes>(module, "Boxes")
        .def(py::init<Ints, Ints, Doubles, Doubles, Ints, Doubles, const std::vector<std::vector<double>>&>())
        .def("place", &Boxes::place)
        .def("use", &Boxes::use)
        .def("undecided", &Boxes::undecided)
        .def("way", &Boxes::way)
        .def("line", &Boxes::line)
        .def("space", &Boxes::space);
    py::class_<Separation>(module, "Separation")
        .def(py::init<Boxes&, Doubles, Ints, const Slots&, Doubles, const Slots&, Doubles, double>(), py::keep_alive<1, 2>())
        .def("open", &Separation::open);
    py::class_<Growth>(module, "Growth")
        .def(py::init<double, double, double, double, double, double, double, double, int, int>(), py::arg("reach"),
             py::arg("least"), py::arg("back"), py::arg("vain"), py::arg("projected"), py::arg("onward"),
             py::arg("tolerance"), py::arg("damping"), py::arg("projections"), py::arg("halvings"));
    py::class_<Trees>(module, "Trees")
        .def(py::init<Boxes&, Doubles, Slots, Doubles, Doubles, Doubles, Doubles, Growth, Arm*, Doubles>(),
             py::keep_alive<1, 2>(), py::keep_alive<1, 10>())
        .def("ends_are_free", &Trees::ends_are_free)
        .def("have_grown", &Trees::have_grown)
        .def("grow", &Trees::grow)
        .def("steer", py::overload_cast<Doubles, Doubles>(&Trees::steer));
}
