"""Diagnostics of the scope rules of chapters III and IV (L5xx)."""

from __future__ import annotations

from lfield.text.message_tables import FindingTable

SCOPE = FindingTable("L5", warnings="L9")
_message = SCOPE.message

RESOURCE_NAMES_RESOURCE = _message(
    "L501",
    "{viewer} cannot name the resource '{name}'",
    "a resource cannot refer to another one; a coordinator carries values between them",
)
RESOURCE_NAMES_COORDINATOR = _message(
    "L502",
    "{viewer} cannot name the coordinator '{name}'",
    "declare a portal; the coordinator calls it",
)
COORDINATOR_NAMES_COORDINATOR = _message(
    "L503",
    "{viewer} cannot name the coordinator '{name}'",
    "coordinators exchange values through resources: write to one portal, read from another",
)
COORDINATOR_NAMES_DEVICE = _message(
    "L504",
    "{viewer} cannot have the device type '{name}'",
    "put the device into a resource and call a portal of that resource",
)
COORDINATOR_IO = _message(
    "L505",
    "{viewer} cannot call {name}: a coordinator does no I/O",
    "use print(...), which writes to the host's log, or a portal of a resource",
)
ONLY_PORTALS = _message(
    "L506",
    "'{name}' is a method inside the resource {resource}; through a proxy only portals can be called",
    "write a portal in {resource} that calls it",
)
PROXY_FIELD = _message(
    "L507",
    "'{name}' cannot be reached: a proxy has no fields",
    "write a portal in {resource} that emits or sets it, and call that",
)
PORTAL_INSIDE = _message(
    "L508",
    "'{name}' is a portal; only coordinators call portals, through a proxy",
    "move its code into a private method and call that here and in the portal",
)
PORTAL_PROXY = _message(
    "L509",
    "{type} cannot pass through a portal: it is or holds a proxy",
    "pass the id (a string), with which the coordinator finds the resource",
)
PORTAL_RESOURCE_CLASS = _message(
    "L510",
    "{type} cannot pass through a portal: it is resource specific",
    "copy what the coordinator needs into an object of a class without a usage clause",
)
PORTAL_EXCEPTION = _message(
    "L511",
    "{type} cannot pass through a portal: {why}",
    "throw the exception, or pass its message() as a string",
)
DEVICE_PLACE = _message(
    "L512",
    "the device type '{name}' is only for fields of a resource or of a resource specific class",
    "declare {name} fc; in the resource; a resource specific class receives it in its constructor",
)
DEVICE_USE = _message(
    "L513", "the device '{name}' is not a value", "call its instructions: {name}.{instruction}(...)"
)
GLOBAL_NAMES_RESOURCE = _message(
    "L514",
    "{viewer} cannot name the resource '{name}'",
    "declare it class {unit} coordinator specific {{ ... }}, or keep only the id of the resource",
)
GLOBAL_NAMES_COORDINATOR = _message(
    "L515",
    "{viewer} cannot name the coordinator '{name}'",
    "a coordinator is not a value; pass the values that the class needs",
)
GLOBAL_IO = _message(
    "L516",
    "{viewer} cannot call {name}: it may run in a coordinator",
    "declare it class {unit} resource specific {{ ... }}, or return the text and write it in a resource",
)
GLOBAL_NAMES_SPECIFIC = _message(
    "L517",
    "{viewer} cannot name '{name}', which is {usage} specific",
    "declare it class {unit} {usage} specific {{ ... }} too, or remove the clause from {name}",
)
RESOURCE_CLASS_OUTSIDE = _message(
    "L518",
    "{viewer} cannot name '{name}', which is resource specific",
    "use a class without a usage clause for data that coordinators and resources share",
)
COORDINATOR_CLASS_OUTSIDE = _message(
    "L519",
    "{viewer} cannot name '{name}', which is coordinator specific",
    "use a class without a usage clause for data that coordinators and resources share",
)
NEW_AGENT = _message(
    "L520", "the {kind} '{name}' cannot be created with new", "the deployment defines its instances{find}"
)
PORTAL_PLACE = _message("L521", "{unit} cannot have portals", "only resources have them; write a method")
PRIVATE_MEMBER = _message(
    "L522", "'{name}' is private in {owner}", "declare it public, or add a public method to {owner}"
)
FIND_PLACE = _message(
    "L523",
    "{viewer} cannot find {what}",
    "only coordinators and coordinator specific classes can; pass the result as a value",
)
COORDINATOR_FUNCTION = _message(
    "L524",
    "{viewer} cannot call {name}: only coordinators migrate and are recovered",
    "call it in the coordinator or a coordinator specific class; pass a result on as a value",
)
THIS_VALUE = _message(
    "L525", "'this' of {unit} is not a value", "use it only for members: this.name or this.method()"
)
DEVICE_THROWN = _message(
    "L527",
    "{type} cannot be thrown: its device '{device}' stays with its resource",
    "throw an object that describes the error",
)
CAPABILITY_OUTSIDE = _message(
    "L526",
    "{viewer} cannot name the capability '{name}'",
    "only coordinators find and call offers of a capability; a resource has portals",
)
FUTURE_PORTAL = _message(
    "L528",
    "a {type} cannot pass through a portal: its call belongs to the coordinator that began it",
    "pass the result: f.await()",
)
ASYNC_PLACE = _message(
    "L529", "{viewer} cannot begin calls with async", "move the async calls into a coordinator"
)
WAIT_PLACE = _message(
    "L530",
    "wait until releases the monitor, and {place} does not hold the monitor",
    "write it in a synchronized portal or method of a resource or of a resource specific class",
)
WAIT_SECONDS = _message(
    "L531",
    "the time of a wait until must be more than 0 seconds, this is {given}",
    "write wait until (...) within (5.0);",
)
