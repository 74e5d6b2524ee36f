/* ros2_work/worker.py in C, without its action: talks, answers, counts, and prints for judge.py.
 *
 * Environment: VERSION such as v1. */
#include "spin.h"

#include <rcl_interfaces/msg/parameter_value.h>
#include <rcl_interfaces/srv/get_parameters.h>
#include <rosidl_runtime_c/string_functions.h>
#include <std_msgs/msg/int64.h>
#include <std_msgs/msg/string.h>
#include <time.h>
#include <unistd.h>

static struct {
  rcl_node_t node;
  rcl_publisher_t chatter, map;
  rcl_subscription_t counter;
  rcl_service_t service;
  rcl_timer_t timer;
  int number;
} own;
static const char *version;

static void report(const char *what, const char *number) {
  struct timespec now;
  char line[256];
  clock_gettime(CLOCK_REALTIME, &now);
  int length = snprintf(line, sizeof line, "%ld.%04ld %s %s %s\n", (long)now.tv_sec, now.tv_nsec / 100000,
                        version, what, number);
  if (write(1, line, (size_t)length) < 0) exit(1);
}

static void publish(rcl_publisher_t *to, const char *text) {
  std_msgs__msg__String message;
  std_msgs__msg__String__init(&message);
  rosidl_runtime_c__String__assign(&message.data, text);
  CHECK(rcl_publish(to, &message, NULL));
  std_msgs__msg__String__fini(&message);
}

static void say(void *unused) {
  char text[64];
  (void)unused;
  snprintf(text, sizeof text, "%s %d", version, own.number++);
  publish(&own.chatter, text);
}

static void count(void *unused) {
  std_msgs__msg__Int64 message;
  char text[32];
  (void)unused;
  if (rcl_take(&own.counter, &message, NULL, NULL) != RCL_RET_OK) return;
  snprintf(text, sizeof text, "%ld", (long)message.data);
  report("count", text);
}

static void answer(void *unused) {
  rmw_request_id_t id;
  rcl_interfaces__srv__GetParameters_Request request;
  rcl_interfaces__srv__GetParameters_Response response;
  (void)unused;
  rcl_interfaces__srv__GetParameters_Request__init(&request);
  rcl_interfaces__srv__GetParameters_Response__init(&response);
  if (rcl_take_request(&own.service, &id, &request) == RCL_RET_OK) {
    report("call", request.names.data[0].data);
    rcl_interfaces__msg__ParameterValue__Sequence__init(&response.values, 1);
    rosidl_runtime_c__String__assign(&response.values.data[0].string_value, version);
    CHECK(rcl_send_response(&own.service, &id, &response));
  }
  rcl_interfaces__srv__GetParameters_Response__fini(&response);
  rcl_interfaces__srv__GetParameters_Request__fini(&request);
}

void *component_begin(struct spin *spin, const char *name) {
  static struct work works[] = {{say, NULL, &own.timer, TIMER, 0, false, 0, NULL, NULL},
                                {count, NULL, &own.counter, SUBSCRIPTION, 0, false, 0, NULL, NULL},
                                {answer, NULL, &own.service, SERVICE, 0, false, 0, NULL, NULL}};
  const rosidl_message_type_support_t *text = ROSIDL_GET_MSG_TYPE_SUPPORT(std_msgs, msg, String);
  (void)name;
  version = getenv("VERSION");
  make_node(spin, &own.node, "worker", "/");
  MAKE(publisher, &own.chatter, &own.node, text, "chatter", options.qos.depth = 1000);
  MAKE(publisher, &own.map, &own.node, text, "map", LATCHED);
  MAKE(subscription, &own.counter, &own.node, ROSIDL_GET_MSG_TYPE_SUPPORT(std_msgs, msg, Int64),
       "counter", options.qos.depth = 1000);
  MAKE(service, &own.service, &own.node,
       ROSIDL_GET_SRV_TYPE_SUPPORT(rcl_interfaces, srv, GetParameters), "work", );
  make_timer(spin, &own.timer, 0.05);
  publish(&own.map, version);
  for (int i = 0; i < 3; i++) spin_add(spin, &works[i]);
  return &own;
}

void component_end(void *unused) { (void)unused; }
