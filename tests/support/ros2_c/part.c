/* The node `part`: echoes the numbers that it hears, -1 after two seconds, ticks, has a latched
 * message, answers, and asks without pause who answers it. */
#include "spin.h"

#include <rcl_interfaces/srv/get_parameters.h>
#include <std_msgs/msg/int64.h>
#include <unistd.h>

struct part {
  struct spin *spin;
  rcl_node_t node;
  rcl_publisher_t echo, tick, map;
  rcl_subscription_t in;
  rcl_service_t ask;
  rcl_client_t peer;
  rcl_timer_t timer;
  int64_t asked, answered;
  struct work works[4];
};

static void publish(rcl_publisher_t *to, int64_t number) {
  std_msgs__msg__Int64 message = {number};
  CHECK(rcl_publish(to, &message, NULL));
}

static void hear(void *of) {
  struct part *part = of;
  std_msgs__msg__Int64 message;
  if (rcl_take(&part->in, &message, NULL, NULL) != RCL_RET_OK) return;
  printf("begins %ld\n", (long)message.data);
  fflush(stdout);
  if (message.data < 0) sleep(2);
  publish(&part->echo, message.data);
}

static void answer(void *of) {
  struct part *part = of;
  rmw_request_id_t id;
  rcl_interfaces__srv__GetParameters_Request request;
  rcl_interfaces__srv__GetParameters_Response response;
  rcl_interfaces__srv__GetParameters_Request__init(&request);
  rcl_interfaces__srv__GetParameters_Response__init(&response);
  if (rcl_take_request(&part->ask, &id, &request) == RCL_RET_OK)
    CHECK(rcl_send_response(&part->ask, &id, &response));
  rcl_interfaces__srv__GetParameters_Response__fini(&response);
  rcl_interfaces__srv__GetParameters_Request__fini(&request);
}

static void be_answered(void *of) {
  struct part *part = of;
  rmw_request_id_t id;
  rcl_interfaces__srv__GetParameters_Response response;
  rcl_interfaces__srv__GetParameters_Response__init(&response);
  if (rcl_take_response(&part->peer, &id, &response) == RCL_RET_OK) part->answered = id.sequence_number;
  rcl_interfaces__srv__GetParameters_Response__fini(&response);
}

static void tick(void *of) {
  struct part *part = of;
  bool there = false;
  publish(&part->tick, 1);
  if (part->asked > part->answered) return;
  if (rcl_service_server_is_available(&part->node, &part->peer, &there) != RCL_RET_OK || !there) return;
  rcl_interfaces__srv__GetParameters_Request request;
  rcl_interfaces__srv__GetParameters_Request__init(&request);
  CHECK(rcl_send_request(&part->peer, &request, &part->asked));
  rcl_interfaces__srv__GetParameters_Request__fini(&request);
}

void *component_begin(struct spin *spin, const char *name) {
  struct part *part = calloc(1, sizeof *part);
  const rosidl_message_type_support_t *number = ROSIDL_GET_MSG_TYPE_SUPPORT(std_msgs, msg, Int64);
  const rosidl_service_type_support_t *ask =
      ROSIDL_GET_SRV_TYPE_SUPPORT(rcl_interfaces, srv, GetParameters);
  char space[64];
  snprintf(space, sizeof space, "/%s", name);
  part->spin = spin;
  make_node(spin, &part->node, "part", space);
  MAKE(publisher, &part->echo, &part->node, number, "echo", );
  MAKE(publisher, &part->tick, &part->node, number, "tick", );
  MAKE(publisher, &part->map, &part->node, number, "map", LATCHED);
  MAKE(subscription, &part->in, &part->node, number, "in", );
  MAKE(service, &part->ask, &part->node, ask, "ask", );
  MAKE(client, &part->peer, &part->node, ask, "peer", );
  make_timer(spin, &part->timer, 0.05);
  publish(&part->map, 5);
  struct work works[] = {{hear, part, &part->in, SUBSCRIPTION, 0, false, 0, NULL, NULL},
                         {answer, part, &part->ask, SERVICE, 0, false, 0, NULL, NULL},
                         {be_answered, part, &part->peer, CLIENT, 0, false, 0, NULL, NULL},
                         {tick, part, &part->timer, TIMER, 0, false, 0, NULL, NULL}};
  memcpy(part->works, works, sizeof works);
  for (int i = 0; i < 4; i++) spin_add(spin, &part->works[i]);
  return part;
}

void component_end(void *component) {
  struct part *part = component;
  for (int i = 0; i < 4; i++) spin_remove(part->spin, &part->works[i]);
  CHECK(rcl_timer_fini(&part->timer));
  CHECK(rcl_client_fini(&part->peer, &part->node));
  CHECK(rcl_service_fini(&part->ask, &part->node));
  CHECK(rcl_subscription_fini(&part->in, &part->node));
  CHECK(rcl_publisher_fini(&part->map, &part->node));
  CHECK(rcl_publisher_fini(&part->tick, &part->node));
  CHECK(rcl_publisher_fini(&part->echo, &part->node));
  CHECK(rcl_node_fini(&part->node));
  free(part);
}
